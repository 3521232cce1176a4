//! Several services on one bus.

use super::*;
use crate::gives_way;

const SOON: Duration = Duration::from_secs(5);

/// Both at one port, one after the other.
fn open_at(endpoints: &str) -> Bus {
    Bus::open(config(endpoints, endpoints)).unwrap()
}

/// Who is told to be a mapper already. A session that just opened may not have met the other yet.
fn mapper_beside(bus: &Bus) -> String {
    let mut words = None;
    until("a mapper is seen", || {
        words = bus.service_alive_elsewhere(&["mapper"], SOON).unwrap();
        words.is_some()
    });
    words.unwrap()
}

#[test]
fn another_service_of_this_node_is_named_before_one_declares_itself() {
    let endpoints = format!("['tcp/127.0.0.1:{}']", free_port());
    let first = open_at(&endpoints);
    assert_eq!(
        first.service_alive_elsewhere(&["mapper"], SOON).unwrap(),
        None
    );
    let alive = first.declare_alive("mapper").unwrap();
    let second = open_at(&endpoints);
    let words = mapper_beside(&second);
    for named in [
        "another service of node \"test\"",
        "mapper",
        &first.zenoh_id(),
    ] {
        assert!(words.contains(named), "{named} in {words}");
    }
    assert_eq!(
        first.service_alive_elsewhere(&["mapper"], SOON).unwrap(),
        None,
        "itself"
    );
    let driver = second.service_alive_elsewhere(&["driver"], SOON);
    assert_eq!(driver.unwrap(), None, "a driver beside a mapper");
    drop(alive);
    until("the token is gone", || {
        second
            .service_alive_elsewhere(&["mapper"], SOON)
            .unwrap()
            .is_none()
    });
}

#[test]
fn a_service_without_a_role_is_seen_too() {
    let endpoints = format!("['tcp/127.0.0.1:{}']", free_port());
    let first = open_at(&endpoints);
    let plain = first.session_for_tests().liveliness();
    let token = plain.declare_token(first.keys().alive()).wait().unwrap();
    let second = open_at(&endpoints);
    let words = mapper_beside(&second);
    assert!(words.contains("does not say its role"), "{words}");
    drop(token);
}

#[test]
fn a_service_of_another_node_is_no_matter() {
    let endpoints = format!("['tcp/127.0.0.1:{}']", free_port());
    let first = Bus::open(config(&endpoints, &endpoints)).unwrap();
    let _alive = first.declare_alive("mapper").unwrap();
    let other = BusConfig {
        node: "replay".to_owned(),
        ..config(&endpoints, &endpoints)
    };
    let second = Bus::open(other).unwrap();
    assert_eq!(
        second.service_alive_elsewhere(&["mapper"], SOON).unwrap(),
        None
    );
}

#[test]
fn of_two_that_started_at_once_exactly_one_gives_way() {
    let (first, second) = pair();
    assert_eq!(first.others_alive("mapper"), Vec::<String>::new());
    // Neither asked in time.
    let _first = first.declare_alive("mapper").unwrap();
    let token = second.declare_alive("mapper").unwrap();
    until("each sees the other", || {
        first.others_alive("mapper") == [second.zenoh_id()]
            && second.others_alive("mapper") == [first.zenoh_id()]
    });
    assert_eq!(first.others_alive("driver"), Vec::<String>::new());
    let yields =
        [(&first), (&second)].map(|bus| gives_way(&bus.zenoh_id(), &bus.others_alive("mapper")));
    assert_ne!(yields[0], yields[1]);
    drop(token);
    until("one that ended is forgotten", || {
        first.others_alive("mapper").is_empty()
    });
}

#[test]
fn a_role_that_is_a_pattern_is_refused() {
    let bus = Bus::open(config("[]", "[]")).unwrap();
    let refused = bus.declare_alive("*").unwrap_err().to_string();
    assert!(refused.contains("role"), "{refused}");
}
