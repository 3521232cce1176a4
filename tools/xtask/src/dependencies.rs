//! Rules over what each crate reaches through normal dependencies, however far down.

use std::collections::BTreeMap;

use crate::crates::{BENCH, DRIVER, Kind, MAPPER, PROGRAM, Purpose, SERVICE, kind_of, purpose_of};
use crate::graph::DependencyGraph;

/// Libraries that open sockets, ports or runtimes. A name stands for its family too: `zenoh` for
/// `zenoh-transport`.
const IO_LIBRARIES: [&str; 12] = [
    "async-io",
    "async-std",
    "axum",
    "hyper",
    "mio",
    "polling",
    "quinn",
    "reqwest",
    "serialport",
    "socket2",
    "tokio",
    "zenoh",
];

/// The broken rules of the workspace's crates, by name, one line each.
pub(crate) fn violations(graphs: &BTreeMap<String, DependencyGraph>) -> Vec<String> {
    let each = graphs.iter().flat_map(|(name, graph)| match kind_of(name) {
        Some(kind) => of_crate(name, kind, graph),
        None => vec![format!(
            "{name} is sorted nowhere: say in tools/xtask/src/crates.rs whether it may do input and output"
        )],
    });
    each.collect()
}

fn of_crate(name: &str, kind: Kind, graph: &DependencyGraph) -> Vec<String> {
    let mut broken = Vec::new();
    if let Kind::Pure { .. } = kind {
        broken.extend(pure_reaches_io(name, graph));
    }
    if ![SERVICE, BENCH, PROGRAM].contains(&name) {
        broken.extend(reaches(graph, SERVICE, || {
            format!("{name} reaches {SERVICE}, which is there for {PROGRAM} and {BENCH}")
        }));
        broken.extend(driver_meets_mapper(name, graph));
    }
    broken.extend(product_reaches_proof(name, graph));
    broken
}

/// Invariant: the product does without its proof, and but for the service's commands without what
/// judges maps.
fn product_reaches_proof(name: &str, graph: &DependencyGraph) -> Vec<String> {
    let mut refused = Vec::new();
    if purpose_of(name) != Purpose::Proof && name != PROGRAM {
        refused.push((Purpose::Proof, "the product's proof"));
    }
    if purpose_of(name) == Purpose::Product && ![SERVICE, PROGRAM].contains(&name) {
        refused.push((Purpose::Judgement, "what judges maps by a truth"));
    }
    let found = refused.into_iter().filter_map(|(purpose, what)| {
        let chain = chain_to_purpose(graph, purpose)?;
        Some(format!("{name} must not reach {what}: {chain}"))
    });
    found.collect()
}

/// What is wrong with the program as it is built for a vehicle, without its default features.
pub(crate) fn violations_on_a_vehicle(graph: &DependencyGraph) -> Option<String> {
    let chain = chain_to_purpose(graph, Purpose::Proof)?;
    Some(format!(
        "{PROGRAM} without its default features must not reach the product's proof: {chain}"
    ))
}

fn chain_to_purpose(graph: &DependencyGraph, purpose: Purpose) -> Option<String> {
    let is_wanted = |name: &str| kind_of(name).is_some() && purpose_of(name) == purpose;
    Some(graph.chain_to(is_wanted)?.join(" → "))
}

/// Invariant: bytes and time come in as arguments.
fn pure_reaches_io(name: &str, graph: &DependencyGraph) -> Vec<String> {
    let libraries = IO_LIBRARIES.iter().filter_map(|library| {
        let chain = graph.chain_to(|reached| is_of_family(reached, library))?;
        Some((*library, chain))
    });
    let own = graph.chain_to(|reached| kind_of(reached) == Some(Kind::Io));
    let own = own.map(|chain| ("a crate that does input and output", chain));
    libraries
        .chain(own)
        .map(|(what, chain)| format!("{name} must not reach {what}: {}", chain.join(" → ")))
        .collect()
}

/// Invariant: driver and mapper meet only in the model, and only the service knows both.
fn driver_meets_mapper(name: &str, graph: &DependencyGraph) -> Option<String> {
    let chain_to = |wanted: &str| graph.chain_to(|reached| reached == wanted);
    let to_driver = (name != DRIVER).then(|| chain_to(DRIVER));
    let to_mapper = (name != MAPPER).then(|| chain_to(MAPPER));
    let chains = [to_driver, to_mapper].into_iter().flatten();
    let chains = chains.collect::<Option<Vec<_>>>()?;
    let chains: Vec<String> = chains.iter().map(|chain| chain.join(" → ")).collect();
    Some(format!(
        "{name} brings driver and mapper together, which only {SERVICE} may: {}",
        chains.join(" and ")
    ))
}

fn reaches(
    graph: &DependencyGraph,
    wanted: &str,
    complaint: impl Fn() -> String,
) -> Option<String> {
    let chain = graph.chain_to(|reached| reached == wanted)?;
    Some(format!("{}: {}", complaint(), chain.join(" → ")))
}

fn is_of_family(name: &str, family: &str) -> bool {
    let rest = name.strip_prefix(family);
    rest.is_some_and(|rest| rest.is_empty() || rest.starts_with('-'))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn violations_of(name: &str, tree_below: &str) -> Vec<String> {
        let tree = format!("0 {name} v0.1.0\n{tree_below}");
        let graph = DependencyGraph::parse(&tree).unwrap();
        violations(&BTreeMap::from([(name.to_owned(), graph)]))
    }

    #[test]
    fn a_sound_workspace_passes() {
        let below = "1 echosplat-model v0.1.0\n2 glam v0.34.0\n1 crossbeam-channel v0.5.0\n";
        assert!(violations_of(MAPPER, below).is_empty());
        let service = "1 echosplat-driver v0.1.0\n1 echosplat-mapper v0.1.0\n1 tokio v1.0.0\n";
        assert!(violations_of(SERVICE, service).is_empty());
        assert!(violations_of("echosplat-bus", "1 zenoh v1.10.0\n2 tokio v1.0.0\n").is_empty());
    }

    #[test]
    fn a_runtime_far_down_is_found_with_its_chain() {
        let below = "1 middle v1.0.0\n2 tokio-util v0.7.0\n3 tokio v1.0.0\n";
        let broken = violations_of("echosplat-session", below);
        assert_eq!(
            broken,
            ["echosplat-session must not reach tokio: echosplat-session → middle → tokio-util"]
        );
    }

    #[test]
    fn every_library_is_refused_to_every_pure_crate() {
        for (name, _, kind) in crate::crates::CRATES {
            for library in IO_LIBRARIES {
                let broken = violations_of(name, &format!("1 {library} v1.0.0\n"));
                let is_pure = matches!(kind, Kind::Pure { .. });
                assert_eq!(!broken.is_empty(), is_pure, "{name} {library}");
            }
        }
    }

    #[test]
    fn a_similar_name_is_no_library_of_that_family() {
        assert!(violations_of("echosplat-model", "1 miow v1.0.0\n").is_empty());
    }

    #[test]
    fn a_pure_crate_reaches_no_io_crate_of_ours() {
        let broken = violations_of("echosplat-metrics", "1 echosplat-bus v0.1.0\n");
        assert_eq!(broken.len(), 1);
        assert!(
            broken[0].ends_with("echosplat-metrics → echosplat-bus"),
            "{broken:?}"
        );
    }

    #[test]
    fn driver_and_mapper_do_not_reach_one_another() {
        for (name, other) in [(DRIVER, MAPPER), (MAPPER, DRIVER)] {
            let broken = violations_of(name, &format!("1 between v1.0.0\n2 {other} v0.1.0\n"));
            let chain = format!("{name} → between → {other}");
            assert!(
                broken.iter().any(|line| line.contains(&chain)),
                "{broken:?}"
            );
        }
    }

    #[test]
    fn only_the_service_brings_driver_and_mapper_together() {
        let below = "1 echosplat-driver v0.1.0\n1 echosplat-mapper v0.1.0\n";
        assert_eq!(violations_of("echosplat-web", below).len(), 1);
        assert!(violations_of("echosplat-web", "1 echosplat-mapper v0.1.0\n").is_empty());
    }

    #[test]
    fn nothing_reaches_the_service() {
        let broken = violations_of("echosplat-web", "1 echosplat-service v0.1.0\n");
        assert_eq!(broken.len(), 1);
    }

    #[test]
    fn the_product_reaches_neither_its_proof_nor_what_judges_maps() {
        let service = violations_of(SERVICE, "1 echosplat-metrics v0.1.0\n");
        assert!(service.is_empty(), "{service:?}");
        for name in [SERVICE, "echosplat-prediction", "echosplat-report"] {
            for proof in [BENCH, "echosplat-paper"] {
                let broken = violations_of(name, &format!("1 between v1.0.0\n2 {proof} v0.1.0\n"));
                let chain = format!("proof: {name} → between → {proof}");
                assert!(
                    broken.iter().any(|line| line.ends_with(&chain)),
                    "{broken:?}"
                );
            }
        }
        for name in [MAPPER, "echosplat-prediction", "echosplat-web"] {
            let broken = violations_of(name, "1 echosplat-report v0.1.0\n");
            assert_eq!(broken.len(), 1, "{broken:?}");
        }
    }

    #[test]
    fn a_vehicles_program_has_no_benches() {
        let with = format!("0 {PROGRAM} v0.1.0\n1 {BENCH} v0.1.0\n2 {SERVICE} v0.1.0\n");
        assert!(violations_of(PROGRAM, with.split_once('\n').unwrap().1).is_empty());
        let graph = DependencyGraph::parse(&with).unwrap();
        assert!(violations_on_a_vehicle(&graph).is_some());
        let without = format!("0 {PROGRAM} v0.1.0\n1 {SERVICE} v0.1.0\n");
        let graph = DependencyGraph::parse(&without).unwrap();
        assert_eq!(violations_on_a_vehicle(&graph), None);
    }

    #[test]
    fn a_new_crate_must_be_sorted() {
        let broken = violations_of("echosplat-new", "");
        assert!(broken[0].contains("echosplat-new is sorted nowhere"));
    }
}
