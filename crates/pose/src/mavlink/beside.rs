//! A DVL beside an autopilot: its velocities go to the vehicles of the link.

use crossbeam_channel::{Receiver, bounded};
use echosplat_model::Timestamp;

use super::fleet::Fleet;
use super::told::Told;
use crate::dvl::velocities;
use crate::link::Address;
use crate::outlet::Outlet;

/// News that wait while the link to the autopilot is being opened: some 20 s of velocities.
const QUEUE_LEN: usize = 1_024;

/// What is heard of the DVL.
#[derive(Debug)]
pub(crate) enum News {
    /// What became of the connection.
    Link(String),
    /// A velocity, and when it arrived.
    Velocity(Told, Timestamp),
}

/// Listens to an autopilot, and to the DVL beside it if there is one. Both are one task: where either panics both begin anew.
pub(super) async fn listen_beside<L: Future<Output = ()>>(
    dvl: Option<&Address>,
    listen: impl FnOnce(Option<Beside>) -> L,
) {
    let Some(dvl) = dvl else {
        return listen(None).await;
    };
    let (sender, news) = bounded(QUEUE_LEN);
    let link = "waiting for it".to_owned();
    tokio::select! {
        never = velocities(dvl, &sender) => match never {},
        () = listen(Some(Beside { news, link })) => {}
    }
}

/// The taker's end.
#[derive(Debug)]
pub(crate) struct Beside {
    news: Receiver<News>,
    link: String,
}

impl Beside {
    /// Hands what came to the vehicles.
    pub(crate) fn feed(&mut self, fleet: &mut Fleet, outlet: &mut Outlet) {
        for news in self.news.try_iter() {
            match news {
                News::Link(link) => self.link = link,
                News::Velocity(told, arrived) => {
                    fleet.moves(&told, arrived, |pose| outlet.hand_on(pose));
                }
            }
        }
    }

    /// What became of the connection to the DVL, beside that to the autopilot.
    pub(crate) fn beside(&self, link: String) -> String {
        match self.link == "up" {
            true => link,
            false => format!("{link}; the DVL: {}", self.link),
        }
    }
}
