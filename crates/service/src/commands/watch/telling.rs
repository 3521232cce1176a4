//! What whoever watches is told: what changes at once, how the map stands now and then, and the end.

use std::time::{Duration, Instant};

use echosplat_bus::Liveliness;
use echosplat_model::{GaussianId, Unsound};
use serde_json::Value;

use super::Ending;
use crate::pipeline::STATUS_VERSION;

/// How often it is told how the map stands, and for the first time.
const EVERY: Duration = Duration::from_secs(10);
const FIRST: Duration = Duration::from_secs(2);

/// The service and its map as they are seen from here.
#[derive(Debug, Clone, Default)]
pub(super) struct Seen<'a> {
    pub(super) liveliness: Liveliness,
    /// Epoch and sequence of the map, once there is one.
    pub(super) position: Option<(u64, u64)>,
    /// Whether it is the last map of the service, and whole.
    pub(super) is_final: bool,
    pub(super) gaussians: usize,
    /// Gaussians left out since they cannot be, each time that one came, and the first.
    pub(super) unsound: u64,
    pub(super) first_unsound: Option<(GaussianId, Unsound)>,
    /// Messages that cannot be read, and what is wrong with the first.
    pub(super) malformed: u64,
    pub(super) first_fault: Option<String>,
    /// The service's newest status.
    pub(super) status: Option<&'a Value>,
}

impl Seen<'_> {
    fn number(&self, path: &str) -> f64 {
        let value = self.status.and_then(|status| status.pointer(path));
        value.and_then(Value::as_f64).unwrap_or(0.0)
    }

    /// The version of its status, if it is newer than is known here.
    fn newer_version(&self) -> Option<u64> {
        let version = self.status?.pointer("/status_version")?.as_u64();
        version.filter(|version| *version > STATUS_VERSION.into())
    }

    /// For a terminal, renewed in place.
    pub(super) fn line(&self) -> String {
        let state = match self.liveliness {
            Liveliness::Unknown => "no service yet",
            Liveliness::Alive => "live",
            Liveliness::Gone => "the service is gone",
        };
        let link = self.status.and_then(|status| status.pointer("/link/state"));
        format!(
            "{state} · {} Gaussians · {:.0} pings, {:.1}/s · sonar {}",
            self.gaussians,
            self.number("/pings_received"),
            self.number("/rates/pings_per_s"),
            link.and_then(Value::as_str).unwrap_or("?"),
        )
    }
}

/// Tells each thing once.
pub(super) struct Telling {
    /// Prefix and node of the keys.
    service: String,
    next_line: Instant,
    liveliness: Liveliness,
    position: Option<(u64, u64)>,
    /// When the map last changed here.
    changed: Option<Instant>,
    is_final: bool,
    has_unsound: bool,
    has_malformed: bool,
    has_newer: bool,
    file_fault: Option<String>,
}

impl Telling {
    pub(super) fn new(service: String, now: Instant) -> Self {
        Self {
            service,
            next_line: now + FIRST,
            liveliness: Liveliness::Unknown,
            position: None,
            changed: None,
            is_final: false,
            has_unsound: false,
            has_malformed: false,
            has_newer: false,
            file_fault: None,
        }
    }

    pub(super) fn tell(&mut self, seen: &Seen<'_>, now: Instant) {
        if seen.position != self.position {
            self.changed = Some(now);
            self.position = seen.position;
        }
        self.tell_of_service(seen);
        self.tell_of_what_is_left_out(seen);
        if let (false, Some(found)) = (self.has_newer, seen.newer_version()) {
            self.has_newer = true;
            tracing::warn!(
                "the service is a newer EchoSplat: its status is of version {found}, and this program knows up to \
                 {STATUS_VERSION}; what is shown of it may be wrong until EchoSplat is updated here"
            );
        }
        if now >= self.next_line {
            self.next_line = now + EVERY;
            tracing::info!("{}", self.standing(seen, now));
        }
    }

    fn tell_of_service(&mut self, seen: &Seen<'_>) {
        let service = &self.service;
        match (self.liveliness, seen.liveliness) {
            (Liveliness::Unknown, Liveliness::Alive) => tracing::info!("{service} is there"),
            (Liveliness::Gone, Liveliness::Alive) => {
                tracing::info!("{service} is back; its map is asked for anew");
            }
            (Liveliness::Unknown | Liveliness::Alive, Liveliness::Gone) => tracing::warn!(
                "{service} has ended, or the link to it: its token {service}/alive is gone; the map \
                 stays as it stands, and is followed again once it is back"
            ),
            _ => {}
        }
        self.liveliness = seen.liveliness;
        if seen.is_final && !self.is_final {
            tracing::info!(
                "{service} has published its last map, and all of it is here: {} Gaussians",
                seen.gaussians
            );
        }
        self.is_final = seen.is_final;
    }

    fn tell_of_what_is_left_out(&mut self, seen: &Seen<'_>) {
        if let (false, Some((id, why))) = (self.has_unsound, seen.first_unsound) {
            self.has_unsound = true;
            tracing::warn!(
                "Gaussian {id} of the service is left out, as all are that cannot be: {why}"
            );
        }
        if let (false, Some(fault)) = (self.has_malformed, &seen.first_fault) {
            self.has_malformed = true;
            tracing::warn!(
                "a message of the map cannot be read, and is left out as all such are: {fault}; is \
                 the service of this version?"
            );
        }
    }

    /// What keeps the map from being written, if anything does.
    pub(super) fn tell_of_file(&mut self, fault: Option<&str>) {
        if let (Some(fault), true) = (fault, fault != self.file_fault.as_deref()) {
            tracing::warn!("the map cannot be written, which is tried again: {fault}");
        }
        self.file_fault = fault.map(str::to_owned);
    }

    /// How the map stands.
    fn standing(&self, seen: &Seen<'_>, now: Instant) -> String {
        let service = &self.service;
        let Some(changed) = self.changed else {
            return match seen.liveliness {
                Liveliness::Alive => format!("{service} is there, and its map has not come yet"),
                Liveliness::Unknown | Liveliness::Gone => format!(
                    "no service under {service}: is `echosplat run` started there, with the same \
                     --prefix and --node, and is zenoh reached (--zenoh)?"
                ),
            };
        };
        let age_s = now.saturating_duration_since(changed).as_secs_f64();
        let gaussians = seen.gaussians;
        let of_map = format!("{gaussians} Gaussians, the newest came {age_s:.1} s ago");
        match seen.liveliness {
            Liveliness::Gone => format!("{service} is gone; {of_map}"),
            Liveliness::Unknown | Liveliness::Alive => format!(
                "{of_map}; {:.0} pings received, {:.1}/s, {:.0} in the map",
                seen.number("/pings_received"),
                seen.number("/rates/pings_per_s"),
                seen.number("/pings_mapped"),
            ),
        }
    }
}

/// How it ended, in words.
pub(super) fn account(ending: Ending, seen: &Seen<'_>, asked_for_a_file: bool) -> String {
    let gaussians = seen.gaussians;
    let mut words = match (ending, seen.position) {
        (_, Some(_)) if seen.is_final => {
            format!("the service's last map, all of it: {gaussians} Gaussians")
        }
        (Ending::Gone, Some(_)) => format!(
            "the service ended without a last map; as it last came, it holds {gaussians} Gaussians"
        ),
        (_, Some(_)) => format!(
            "the map as it stands, which is not its last: {gaussians} Gaussians{}",
            match seen.liveliness {
                Liveliness::Gone => "; the service is gone",
                _ => "; the service goes on",
            }
        ),
        (_, None) => "no map came: no service was seen, or it published none".to_owned(),
    };
    if seen.position.is_none() && asked_for_a_file {
        words += ", so none is written";
    }
    if let Some((id, why)) = seen.first_unsound {
        words += &format!(
            "\n{} times a Gaussian was left out that cannot be; the first was {id}: {why}",
            seen.unsound
        );
    }
    if let Some(fault) = &seen.first_fault {
        words += &format!(
            "\n{} messages could not be read; the first: {fault}",
            seen.malformed
        );
    }
    words
}

#[cfg(test)]
mod tests {
    use super::*;
    use serde_json::json;

    fn seconds(s: u64) -> Duration {
        Duration::from_secs(s)
    }

    #[test]
    fn how_the_map_stands_is_said_whether_or_not_there_is_one() {
        let begin = Instant::now();
        let mut telling = Telling::new("echosplat/vehicle".to_owned(), begin);
        let nobody = Seen::default();
        telling.tell(&nobody, begin);
        let words = telling.standing(&nobody, begin);
        assert!(
            words.contains("no service under echosplat/vehicle"),
            "{words}"
        );
        let status = json!({
            "pings_received": 900, "pings_mapped": 880, "rates": {"pings_per_s": 57.96}
        });
        let live = Seen {
            liveliness: Liveliness::Alive,
            position: Some((7, 3)),
            gaussians: 1234,
            status: Some(&status),
            ..Seen::default()
        };
        telling.tell(&live, begin + seconds(5));
        assert_eq!(
            telling.standing(&live, begin + seconds(7)),
            "1234 Gaussians, the newest came 2.0 s ago; 900 pings received, 58.0/s, 880 in the map"
        );
        assert_eq!(live.newer_version(), None);
        let newer = json!({"status_version": STATUS_VERSION + 1});
        let of_newer = Seen {
            status: Some(&newer),
            ..live.clone()
        };
        assert_eq!(
            of_newer.newer_version(),
            Some(u64::from(STATUS_VERSION) + 1)
        );
        let gone = Seen {
            liveliness: Liveliness::Gone,
            ..live
        };
        telling.tell(&gone, begin + seconds(8));
        let words = telling.standing(&gone, begin + seconds(65));
        assert!(
            words.contains("is gone") && words.contains("60.0 s ago"),
            "{words}"
        );
    }

    #[test]
    fn the_end_is_said_in_words() {
        let live = Seen {
            liveliness: Liveliness::Alive,
            position: Some((7, 3)),
            gaussians: 5,
            ..Seen::default()
        };
        let last = Seen {
            is_final: true,
            ..live.clone()
        };
        let none = Seen::default();
        let left_out = Seen {
            unsound: 2,
            first_unsound: Some((9, Unsound::Rotation)),
            ..live.clone()
        };
        for (ending, seen, words) in [
            (Ending::Final, &last, "last map, all of it: 5 Gaussians"),
            (Ending::Asked, &last, "last map, all of it: 5 Gaussians"),
            (
                Ending::Asked,
                &live,
                "not its last: 5 Gaussians; the service goes on",
            ),
            (Ending::Gone, &live, "ended without a last map"),
            (Ending::Asked, &none, "no map came"),
            (Ending::Asked, &none, "none is written"),
            (
                Ending::Asked,
                &left_out,
                "2 times a Gaussian was left out that cannot be; the first was 9",
            ),
        ] {
            let account = account(ending, seen, true);
            assert!(account.contains(words), "{account}");
        }
    }
}
