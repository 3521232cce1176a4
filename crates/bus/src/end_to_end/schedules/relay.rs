//! A session between publisher and follower that hands on what it hears under one prefix under
//! another, and not always.

use std::sync::{Mutex, MutexGuard, PoisonError};

use crossbeam_channel::{Receiver, RecvTimeoutError, Sender, unbounded};
use zenoh::liveliness::LivelinessToken;
use zenoh::query::Query;
use zenoh::sample::{Sample, SampleKind};

use super::dice::Dice;
use super::*;

pub(super) const NEAR: &str = "near";
pub(super) const FAR: &str = "far";

/// Held back for at most so long.
pub(super) const HELD: Duration = Duration::from_millis(60);

/// How likely what is, in percent.
#[derive(Debug, Clone, Copy)]
pub(super) struct Weather {
    pub(super) lost: u64,
    pub(super) held: u64,
    pub(super) doubled: u64,
    /// Of the messages of an answer.
    pub(super) lost_replies: u64,
}

impl Weather {
    pub(super) const CALM: Self = Self {
        lost: 0,
        held: 0,
        doubled: 0,
        lost_replies: 0,
    };
}

pub(super) struct Relay {
    shared: Arc<Shared>,
    _declared: Box<dyn Send>,
}

struct Shared {
    session: zenoh::Session,
    state: Mutex<State>,
}

struct State {
    weather: Weather,
    /// Nothing comes through, as if the publisher were gone.
    is_deaf: bool,
    is_publisher_alive: bool,
    token: Option<LivelinessToken>,
    newest_delta: Instant,
    dice: Dice,
}

fn other(key: &str) -> String {
    key.replacen(NEAR, FAR, 1)
}

impl Relay {
    /// Listens at this port.
    pub(super) fn at(port: u16, seed: u64, weather: Weather) -> Self {
        let mut config = zenoh::Config::default();
        let here = format!("['tcp/127.0.0.1:{port}']");
        for (key, value) in [
            ("scouting/multicast/enabled", "false"),
            ("scouting/gossip/enabled", "false"),
            ("listen/endpoints", here.as_str()),
        ] {
            config.insert_json5(key, value).unwrap();
        }
        let shared = Arc::new(Shared {
            session: zenoh::open(config).wait().unwrap(),
            state: Mutex::new(State {
                weather,
                is_deaf: false,
                is_publisher_alive: false,
                token: None,
                newest_delta: Instant::now(),
                dice: Dice::new(seed),
            }),
        });
        let declared = Box::new((
            shared.pass_deltas(),
            shared.pass_queries(),
            shared.pass_token(),
        ));
        Self {
            shared,
            _declared: declared,
        }
    }

    pub(super) fn set_weather(&self, weather: Weather) {
        self.shared.state().weather = weather;
    }

    /// Whether the publisher seems to be gone.
    pub(super) fn set_deaf(&self, is_deaf: bool) {
        self.shared.state().is_deaf = is_deaf;
        self.shared.renew_token();
    }

    /// When the publisher's newest delta message came here.
    pub(super) fn newest_delta(&self) -> Instant {
        self.shared.state().newest_delta
    }
}

impl Shared {
    fn state(&self) -> MutexGuard<'_, State> {
        self.state.lock().unwrap_or_else(PoisonError::into_inner)
    }

    fn pass_deltas(self: &Arc<Self>) -> impl Send + use<> {
        let (sender, samples) = unbounded();
        let key = format!("{NEAR}/test/map/delta/*");
        let subscriber = self.session.declare_subscriber(key);
        let subscriber = subscriber.callback(move |sample| _ = sender.send(sample));
        let subscriber = subscriber.wait().unwrap();
        let shared = Arc::clone(self);
        std::thread::spawn(move || shared.deltas(&samples));
        subscriber
    }

    /// Until the subscriber is gone.
    fn deltas(&self, samples: &Receiver<Sample>) {
        let mut held: Vec<(Instant, Sample)> = Vec::new();
        loop {
            match samples.recv_timeout(Duration::from_millis(5)) {
                Ok(sample) => self.delta(&sample, &mut held),
                Err(RecvTimeoutError::Timeout) => {}
                Err(RecvTimeoutError::Disconnected) => return,
            }
            for (_, late) in held.extract_if(.., |(due, _)| *due <= Instant::now()) {
                self.put(&late);
            }
        }
    }

    fn delta(&self, sample: &Sample, held: &mut Vec<(Instant, Sample)>) {
        let (copies, hold) = {
            let mut state = self.state();
            state.newest_delta = Instant::now();
            let weather = state.weather;
            if state.is_deaf || state.dice.is_below(weather.lost) {
                return;
            }
            let copies = 1 + u32::from(state.dice.is_below(weather.doubled));
            let is_held = state.dice.is_below(weather.held);
            let hold = is_held.then(|| HELD.mul_f64(state.dice.share()));
            (copies, hold)
        };
        for _ in 0..copies {
            match hold {
                Some(hold) => held.push((Instant::now() + hold, sample.clone())),
                None => self.put(sample),
            }
        }
    }

    fn put(&self, sample: &Sample) {
        let key = other(sample.key_expr().as_str());
        let put = self.session.put(key, sample.payload().clone());
        let attachment = sample.attachment().cloned();
        let put = put
            .encoding(sample.encoding().clone())
            .attachment(attachment);
        put.congestion_control(CongestionControl::Block)
            .wait()
            .unwrap();
    }

    fn pass_queries(self: &Arc<Self>) -> impl Send + use<> {
        let (sender, queries): (Sender<Query>, _) = unbounded();
        let key = format!("{FAR}/test/map/snapshot");
        let queryable = self.session.declare_queryable(key);
        let queryable = queryable.callback(move |query| _ = sender.send(query));
        let queryable = queryable.wait().unwrap();
        let shared = Arc::clone(self);
        std::thread::spawn(move || {
            for query in &queries {
                shared.query(&query);
            }
        });
        queryable
    }

    fn query(&self, query: &Query) {
        if self.state().is_deaf {
            return;
        }
        let selector = format!("{NEAR}/test/map/snapshot?{}", query.parameters());
        let get = self.session.get(selector.trim_end_matches('?'));
        let get = get.consolidation(ConsolidationMode::None);
        let replies = get.congestion_control(CongestionControl::Block).wait();
        for reply in replies.unwrap() {
            let Ok(sample) = reply.into_result() else {
                continue;
            };
            {
                let mut state = self.state();
                let lost = state.weather.lost_replies;
                if state.is_deaf || state.dice.is_below(lost) {
                    continue;
                }
            }
            let reply = query.reply(query.key_expr(), sample.payload().clone());
            let attachment = sample.attachment().cloned();
            let reply = reply
                .encoding(sample.encoding().clone())
                .attachment(attachment);
            // The follower may have gone.
            let _ = reply.wait();
        }
    }

    fn pass_token(self: &Arc<Self>) -> impl Send + use<> {
        let shared = Arc::clone(self);
        let token = self.session.liveliness();
        let token = token.declare_subscriber(format!("{NEAR}/test/alive"));
        let token = token.history(true).callback(move |sample| {
            shared.state().is_publisher_alive = sample.kind() == SampleKind::Put;
            shared.renew_token();
        });
        token.wait().unwrap()
    }

    fn renew_token(&self) {
        let mut state = self.state();
        if state.is_deaf || !state.is_publisher_alive {
            state.token = None;
        } else if state.token.is_none() {
            let token = self.session.liveliness();
            let token = token.declare_token(format!("{FAR}/test/alive"));
            state.token = Some(token.wait().unwrap());
        }
    }
}
