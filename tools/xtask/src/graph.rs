//! What a crate depends on, read from `cargo tree`.

use std::collections::{BTreeMap, BTreeSet, VecDeque};

use anyhow::{Context, bail};

/// Package ids (`name vX.Y.Z`) and the packages each depends on directly.
#[derive(Debug, Default)]
pub(crate) struct DependencyGraph {
    root: String,
    edges: BTreeMap<String, BTreeSet<String>>,
}

impl DependencyGraph {
    /// Reads what `cargo tree --prefix depth --format ' {p}'` prints for one package. A package
    /// that `cargo tree` marks `(*)` has its dependencies listed at its first mention.
    pub(crate) fn parse(tree: &str) -> anyhow::Result<Self> {
        let mut graph = Self::default();
        let mut ancestors: Vec<String> = Vec::new();
        for line in tree.lines().filter(|line| !line.trim().is_empty()) {
            let (depth, package) = parse_line(line)?;
            if depth > ancestors.len() {
                bail!("cargo tree skips a level at {line:?}");
            }
            ancestors.truncate(depth);
            graph.add(ancestors.last(), &package);
            ancestors.push(package);
        }
        Ok(graph)
    }

    fn add(&mut self, parent: Option<&String>, package: &str) {
        match parent {
            None => self.root = package.to_owned(),
            Some(parent) => {
                let below = self.edges.entry(parent.clone()).or_default();
                below.insert(package.to_owned());
            }
        }
    }

    /// The shortest chain of names from the root to a package whose name is `wanted`, the root
    /// itself not counted; `None` if it is out of reach.
    pub(crate) fn chain_to(&self, wanted: impl Fn(&str) -> bool) -> Option<Vec<String>> {
        let mut reached_from: BTreeMap<&str, &str> = BTreeMap::new();
        let mut queue = VecDeque::from([self.root.as_str()]);
        while let Some(package) = queue.pop_front() {
            if package != self.root && wanted(name_of(package)) {
                return Some(self.walk_back(package, &reached_from));
            }
            for below in self.edges.get(package).into_iter().flatten() {
                if below != &self.root && !reached_from.contains_key(below.as_str()) {
                    reached_from.insert(below, package);
                    queue.push_back(below);
                }
            }
        }
        None
    }

    fn walk_back(&self, end: &str, reached_from: &BTreeMap<&str, &str>) -> Vec<String> {
        let mut chain = vec![name_of(end).to_owned()];
        let mut package = end;
        while let Some(above) = reached_from.get(package) {
            chain.push(name_of(above).to_owned());
            package = above;
        }
        chain.reverse();
        chain
    }
}

fn name_of(package: &str) -> &str {
    package.split(' ').next().unwrap_or(package)
}

fn parse_line(line: &str) -> anyhow::Result<(usize, String)> {
    let mut words = line.split_whitespace();
    let depth = words.next().context("an empty line")?;
    let depth = depth
        .parse()
        .with_context(|| format!("no depth at the start of {line:?}"))?;
    let (Some(name), Some(version)) = (words.next(), words.next()) else {
        bail!("no name and version in {line:?}");
    };
    Ok((depth, format!("{name} {version}")))
}

#[cfg(test)]
mod tests {
    use super::*;

    const TREE: &str = "\
0 a v0.1.0 (/somewhere/a)
1 b v1.0.0
2 c v1.0.0
3 tokio v1.2.3
1 d v2.0.0 (proc-macro)
2 c v2.0.0
1 c v1.0.0 (*)
";

    #[test]
    fn the_shortest_chain_is_named() {
        let graph = DependencyGraph::parse(TREE).unwrap();
        let chain = graph.chain_to(|name| name == "tokio").unwrap();
        assert_eq!(chain, ["a", "c", "tokio"]);
    }

    #[test]
    fn versions_of_one_crate_are_kept_apart() {
        let without = TREE
            .replace("1 c v1.0.0 (*)\n", "")
            .replace("2 c v1.0.0\n3 tokio v1.2.3\n", "");
        let graph = DependencyGraph::parse(&without).unwrap();
        assert_eq!(graph.chain_to(|name| name == "tokio"), None);
        assert!(graph.chain_to(|name| name == "c").is_some());
    }

    #[test]
    fn a_crate_does_not_reach_itself() {
        let graph = DependencyGraph::parse(TREE).unwrap();
        assert_eq!(graph.chain_to(|name| name == "a"), None);
    }

    #[test]
    fn what_is_no_tree_is_refused() {
        for text in ["a v1", "0 a", "0 a v1\n2 b v1"] {
            assert!(DependencyGraph::parse(text).is_err(), "{text}");
        }
    }
}
