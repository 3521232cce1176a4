//! Who else says to be this vehicle's service.
//!
//! Two services under one node would mix their poses and publish two maps under one name. So a
//! service asks before it declares itself ([`crate::Bus::service_alive_elsewhere`]), and goes on
//! watching for another of its role, since two may start at one moment and neither see the other:
//! then the one whose zenoh id is the larger number gives way ([`gives_way`]).

use std::collections::BTreeSet;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};

use zenoh::Wait;
use zenoh::liveliness::LivelinessToken;
use zenoh::pubsub::Subscriber;
use zenoh::sample::{Sample, SampleKind};

use crate::BusError;
use crate::bus::Link;
use crate::keys;

/// Most tokens kept; a stranger may declare any number.
const MAX_TOKENS: usize = 64;

/// Longest id of a zenoh session: sixteen bytes in hexadecimal.
const MAX_ZENOH_ID_CHARS: usize = 32;

/// How often the bus is asked again while it may still be connecting.
const ASK_EVERY: Duration = Duration::from_millis(50);

/// The role of a service that publishes a map; followers of the map look for the plain token too.
pub const MAPPER_ROLE: &str = "mapper";
/// The role of a service that talks to the sonar.
pub const DRIVER_ROLE: &str = "driver";

/// While it is held, others see the service as alive.
#[derive(Debug)]
#[expect(dead_code, reason = "held for its end")]
pub struct AliveToken(Vec<LivelinessToken>);

/// A session that says to be the service, in a role.
#[derive(Debug, Clone, PartialEq, Eq, PartialOrd, Ord)]
struct Claim {
    role: String,
    zenoh_id: String,
}

/// Whether, of services of one role, the one with zenoh id `ours` ends: if `ours` is larger than
/// any of `others`, as hexadecimal numbers. All but one of them find that they do.
#[must_use]
pub fn gives_way(ours: &str, others: &[String]) -> bool {
    let number = |id: &str| {
        (
            id.trim_start_matches('0').len(),
            id.trim_start_matches('0').to_lowercase(),
        )
    };
    others.iter().any(|other| number(ours) > number(other))
}

pub(crate) fn declare(link: &Link, role: &str) -> Result<AliveToken, BusError> {
    keys::check_role(role)?;
    let zenoh_id = link.session.zid().to_string();
    let token = |key: String| {
        let declared = link.session.liveliness().declare_token(key).wait();
        declared.map_err(BusError::zenoh("declare the liveliness token"))
    };
    let mut tokens = vec![token(link.keys.alive_as(role, &zenoh_id))?];
    if role == MAPPER_ROLE {
        tokens.push(token(link.keys.alive())?);
    }
    Ok(AliveToken(tokens))
}

/// Those seen of other sessions, from its beginning on.
#[derive(Debug)]
pub(crate) struct Watch {
    claims: Arc<Mutex<BTreeSet<Claim>>>,
    _tokens: Subscriber<()>,
}

fn lock(claims: &Mutex<BTreeSet<Claim>>) -> MutexGuard<'_, BTreeSet<Claim>> {
    claims.lock().unwrap_or_else(PoisonError::into_inner)
}

impl Watch {
    pub(crate) fn start(link: &Link) -> Result<Self, BusError> {
        let claims = Arc::new(Mutex::new(BTreeSet::new()));
        let in_callback = Arc::clone(&claims);
        let ours = link.session.zid().to_string();
        let subscriber = link.session.liveliness();
        let tokens = subscriber
            .declare_subscriber(link.keys.alive_in_any_role())
            .history(true)
            .callback(move |sample| note(&in_callback, &ours, &sample))
            .wait()
            .map_err(BusError::zenoh("watch for other services"))?;
        Ok(Self {
            claims,
            _tokens: tokens,
        })
    }

    /// Zenoh ids of other sessions in this role, in order.
    pub(crate) fn others(&self, role: &str) -> Vec<String> {
        let claims = lock(&self.claims);
        let of_role = claims.iter().filter(|claim| claim.role == role);
        of_role.map(|claim| claim.zenoh_id.clone()).collect()
    }
}

fn note(claims: &Mutex<BTreeSet<Claim>>, ours: &str, sample: &Sample) {
    let claim = claim_of(sample.key_expr().as_str());
    let Some(claim) = claim.filter(|claim| claim.zenoh_id != ours) else {
        return;
    };
    let mut claims = lock(claims);
    match sample.kind() {
        SampleKind::Put if claims.len() < MAX_TOKENS => _ = claims.insert(claim),
        SampleKind::Put => {}
        SampleKind::Delete => _ = claims.remove(&claim),
    }
}

/// Of `…/alive/<role>/<zenoh id>`; `None` for any other key.
fn claim_of(key: &str) -> Option<Claim> {
    let mut parts = key.rsplit('/');
    let (zenoh_id, role, alive) = (parts.next()?, parts.next()?, parts.next()?);
    let fits = alive == "alive"
        && keys::check_role(role).is_ok()
        && zenoh_id.len() <= MAX_ZENOH_ID_CHARS
        && zenoh_id.chars().all(|c| c.is_ascii_hexdigit());
    fits.then(|| Claim {
        role: role.to_owned(),
        zenoh_id: zenoh_id.to_owned(),
    })
}

/// Words naming the service that is there already in one of these roles. Where the bus may still be connecting
/// (`may_connect` says so), it is asked until `limit` is over; else once.
pub(crate) fn elsewhere(
    link: &Link,
    roles: &[&str],
    limit: Duration,
    may_connect: impl Fn() -> bool,
) -> Result<Option<String>, BusError> {
    let deadline = Instant::now() + limit;
    loop {
        // Asked before the question, so that who connects in between is asked as well.
        let is_last = !may_connect();
        let left = deadline.saturating_duration_since(Instant::now());
        let keys = ask(link, left.max(ASK_EVERY))?;
        if let Some(who) = who(link, roles, &keys) {
            return Ok(Some(who));
        }
        if is_last || Instant::now() + ASK_EVERY >= deadline {
            return Ok(None);
        }
        std::thread::sleep(ASK_EVERY);
    }
}

/// Keys of the tokens there are, at most so many as are kept.
fn ask(link: &Link, limit: Duration) -> Result<Vec<String>, BusError> {
    let liveliness = link.session.liveliness();
    let asked = liveliness.get(link.keys.alive_anyhow()).timeout(limit);
    let replies = asked
        .wait()
        .map_err(BusError::zenoh("ask for other services"))?;
    let mut keys = Vec::new();
    while let Ok(Some(reply)) = replies.recv_timeout(limit) {
        if let Ok(sample) = reply.result() {
            keys.push(sample.key_expr().as_str().to_owned());
        }
        if keys.len() >= MAX_TOKENS {
            break;
        }
    }
    Ok(keys)
}

/// Whom these tokens stand for, our own left out.
fn who(link: &Link, roles: &[&str], keys: &[String]) -> Option<String> {
    let ours = link.session.zid().to_string();
    let claims: Vec<Claim> = keys.iter().filter_map(|key| claim_of(key)).collect();
    let in_the_way =
        |claim: &&Claim| claim.zenoh_id != ours && roles.contains(&claim.role.as_str());
    let other = claims.iter().find(in_the_way);
    let name = match (other, claims.is_empty() && !keys.is_empty()) {
        (Some(other), _) => format!("role {}, zenoh id {}", other.role, other.zenoh_id),
        (None, true) => "of a version that does not say its role".to_owned(),
        (None, false) => return None,
    };
    let node = &link.config.node;
    Some(format!(
        "another service of node {node:?} is on the bus ({name}): end it, or give this one a node \
         of its own"
    ))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn ids(ids: &[&str]) -> Vec<String> {
        ids.iter().map(|id| (*id).to_owned()).collect()
    }

    #[test]
    fn of_any_number_exactly_one_does_not_give_way() {
        let all = ids(&["ff", "100", "0a", "fe01", "abc"]);
        let stays = |ours: &&String| {
            let others: Vec<String> = all.iter().filter(|id| id != ours).cloned().collect();
            !gives_way(ours, &others)
        };
        let staying: Vec<&String> = all.iter().filter(stays).collect();
        assert_eq!(staying, ["0a"]);
    }

    #[test]
    fn who_is_alone_stays() {
        assert!(!gives_way("ff", &[]));
        assert!(gives_way("100", &ids(&["ff"])));
        assert!(!gives_way("ff", &ids(&["100"])));
    }

    #[test]
    fn only_tokens_with_a_role_and_an_id_are_claims() {
        let claim = claim_of("sea/north/rov/alive/mapper/a1").unwrap();
        assert_eq!(
            (claim.role.as_str(), claim.zenoh_id.as_str()),
            ("mapper", "a1")
        );
        for other in [
            "rov/alive",
            "rov/alive/mapper",
            "rov/alive/mapper/xyz",
            "a/b/c",
            "",
        ] {
            assert_eq!(claim_of(other), None, "{other}");
        }
        let long = format!("rov/alive/mapper/{}", "a".repeat(33));
        assert_eq!(claim_of(&long), None);
    }
}
