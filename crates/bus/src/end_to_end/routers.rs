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
