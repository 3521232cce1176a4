//! More than two programs on one bus: with a router between them, and without.

use super::*;

fn open(mode: &str, node: &str, connect: &str, listen: &str) -> Bus {
    let mut config = config(connect, listen);
    config.zenoh.push(("mode".to_owned(), format!("'{mode}'")));
    config.node = node.to_owned();
    Bus::open(config).unwrap()
}

fn here() -> String {
    format!("['tcp/127.0.0.1:{}']", free_port())
}

#[test]
fn clients_meet_through_a_router_and_peers_do_not() {
    let here = here();
    let _router = open("router", "nobody", "[]", &here);
    for publisher_mode in ["client", "peer"] {
        let service = open(publisher_mode, publisher_mode, &here, "[]");
        let publisher = service.publish_map().unwrap();
        publisher.offer(round(0));
        publisher.flush(LONG).unwrap();
        let peer = open("peer", publisher_mode, &here, "[]");
        let of_peer = peer.subscribe_map().unwrap();
        let client = open("client", publisher_mode, &here, "[]");
        let map = client.subscribe_map().unwrap().wait_final(LONG).unwrap();
        assert!(same(&map.gaussians, &round(0).gaussians));
        assert_eq!(client.endpoints().warnings, Vec::<String>::new());
        // A session may open before it has met the router; then it has nothing to warn of.
        until("a peer is told to be a client", || {
            let peer = open("peer", publisher_mode, &here, "[]");
            let warnings = peer.endpoints().warnings.join("\n");
            warnings.contains("mode=\"client\"")
        });
        match publisher_mode {
            "client" => _ = of_peer.wait_final(LONG).unwrap(),
            _ => assert_eq!(of_peer.position(), None, "between two peers"),
        }
    }
}

#[test]
fn a_client_opens_without_its_router_and_meets_others_whenever_it_is_there() {
    let here = here();
    let service = open("client", "test", &here, "[]");
    assert_eq!(service.endpoints().connected_count, 0);
    let is_told = || {
        let unreached = service.unreached();
        unreached.iter().any(|to| to.reason.contains("refused"))
    };
    until("what is in the way is told", is_told);
    let publisher = service.publish_map().unwrap();
    publisher.offer(round(0));
    publisher.flush(LONG).unwrap();
    for _ in 0..2 {
        let router = open("router", "nobody", "[]", &here);
        let client = open("client", "test", &here, "[]");
        let map = client.subscribe_map().unwrap().wait_final(LONG).unwrap();
        assert!(same(&map.gaussians, &round(0).gaussians));
        until("nothing is in the way", || service.unreached().is_empty());
        close(client);
        close(router);
        until("it is told again", is_told);
    }
}

#[test]
fn nothing_at_the_other_end_keeps_a_session_from_opening() {
    let held = TcpListener::bind("127.0.0.1:0").unwrap();
    let held_port = held.local_addr().unwrap().port();
    for (endpoint, word) in [
        (format!("tcp/127.0.0.1:{held_port}"), "another program"),
        (
            "tcp/no-such-host.invalid:7447".to_owned(),
            "no-such-host.invalid is not found",
        ),
    ] {
        for mode in ["client", "peer"] {
            let mut config = config(&format!("['{endpoint}']"), "[]");
            for (key, value) in [
                ("mode", format!("'{mode}'")),
                ("connect/exit_on_failure", "true".to_owned()),
                ("connect/timeout_ms", "0".to_owned()),
                // A client with a password wants to be asked for it.
                ("transport/auth/usrpwd/user", "'rov'".to_owned()),
                ("transport/auth/usrpwd/password", "'a:b c'".to_owned()),
            ] {
                config.zenoh.push((key.to_owned(), value));
            }
            let bus = Bus::open(config).unwrap();
            until("it is told", || {
                let unreached = bus.unreached();
                let told =
                    |to: &crate::Unreached| to.endpoint == endpoint && to.reason.contains(word);
                unreached.iter().any(told)
            });
            close(bus);
        }
    }
}

#[test]
fn a_peer_does_not_relay_for_two_others() {
    let here = here();
    let first = open("peer", "test", &here, &here);
    let service = open("peer", "test", &here, &here);
    let publisher = service.publish_map().unwrap();
    publisher.offer(round(0));
    publisher.flush(LONG).unwrap();
    let third = open("peer", "test", &here, &here);
    let of_third = third.subscribe_map().unwrap();
    let of_first = first.subscribe_map().unwrap();
    of_first.wait_final(LONG).unwrap();
    assert_eq!(of_third.position(), None);
}
