//! The longest path through the blocks of a routine: loops become single blocks, the innermost first.

use std::collections::{BTreeMap, BTreeSet};

use super::Cost;
use crate::hir::Location;

/// The number of a loop, as its mark has it.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub struct LoopMark(pub u32);

/// A block of machine code: it is entered at its beginning and left at its end.
#[derive(Debug, Default)]
pub struct Block {
    pub instructions: u64,
    /// Routines of the program that it calls.
    pub calls: Vec<u32>,
    pub runtime_calls: u64,
    /// Loops that it is in, without a loop within that loop between.
    pub marks: Vec<LoopMark>,
    /// Where it leads.
    pub next: BTreeSet<usize>,
}

/// Blocks, of which some have been joined.
pub struct Graph {
    nodes: BTreeMap<usize, Node>,
}

struct Node {
    cost: Cost,
    marks: Vec<LoopMark>,
    next: BTreeSet<usize>,
}

/// What is left of a loop: where it begins, and all that is in it.
struct Found {
    head: usize,
    body: BTreeSet<usize>,
}

impl Graph {
    /// The blocks with what each takes. The first is where the routine begins.
    pub fn new(blocks: &[Block], costs: Vec<Cost>) -> Graph {
        let node = |(block, cost): (&Block, Cost)| Node {
            cost,
            marks: block.marks.clone(),
            next: block.next.clone(),
        };
        Graph { nodes: blocks.iter().zip(costs).map(node).enumerate().collect() }
    }

    /// What the longest path from the first block takes. `rounds` says how often the loop with a mark is entered anew;
    /// loops without a bound are added to `unbounded`.
    pub fn longest(
        mut self,
        rounds: &dyn Fn(Option<LoopMark>) -> Result<u64, Location>,
        unbounded: &mut Vec<Location>,
    ) -> Cost {
        while let Some(found) = self.innermost() {
            let mut marks: Vec<LoopMark> =
                found.body.iter().flat_map(|node| self.nodes[node].marks.clone()).collect();
            marks.sort_unstable();
            marks.dedup();
            let only = if let [mark] = marks[..] { Some(mark) } else { None };
            let rounds = rounds(only).unwrap_or_else(|location| {
                unbounded.push(location);
                0
            });
            self.join(&found, rounds);
        }
        let all: BTreeSet<usize> = self.nodes.keys().copied().collect();
        self.distances(0, &all).into_values().fold(Cost::default(), Cost::or)
    }

    /// A loop in which there is no other one.
    fn innermost(&self) -> Option<Found> {
        let mut loops: BTreeMap<usize, BTreeSet<usize>> = BTreeMap::new();
        for (from, head) in self.backward() {
            loops.entry(head).or_insert_with(|| [head].into()).extend(self.between(head, from));
        }
        let smallest = loops.into_iter().min_by_key(|(_, body)| body.len());
        smallest.map(|(head, body)| Found { head, body })
    }

    /// Edges that lead back to a block on the way to them. Cranelift's code has loops with one entry only, so these do
    /// not depend on the order of the search.
    fn backward(&self) -> Vec<(usize, usize)> {
        let (mut edges, mut seen, mut open) =
            (Vec::new(), BTreeSet::from([0]), BTreeSet::from([0]));
        let mut stack = vec![(0, self.following(0))];
        while let Some((node, rest)) = stack.last_mut() {
            let node = *node;
            let Some(next) = rest.pop() else {
                open.remove(&node);
                stack.pop();
                continue;
            };
            if open.contains(&next) {
                edges.push((node, next));
            } else if seen.insert(next) {
                open.insert(next);
                stack.push((next, self.following(next)));
            }
        }
        edges
    }

    fn following(&self, node: usize) -> Vec<usize> {
        self.nodes.get(&node).map_or_else(Vec::new, |node| node.next.iter().copied().collect())
    }

    /// All blocks from which `from` can be reached without passing `head`.
    fn between(&self, head: usize, from: usize) -> BTreeSet<usize> {
        let mut before: BTreeMap<usize, Vec<usize>> = BTreeMap::new();
        for (node, content) in &self.nodes {
            for next in &content.next {
                before.entry(*next).or_default().push(*node);
            }
        }
        let mut found = BTreeSet::from([head]);
        let mut left = vec![from];
        while let Some(node) = left.pop() {
            if found.insert(node) {
                left.extend(before.get(&node).into_iter().flatten());
            }
        }
        found
    }

    /// Makes one block of a loop.
    fn join(&mut self, found: &Found, rounds: u64) {
        let distances = self.distances(found.head, &found.body);
        let again = |node: &usize| self.nodes[node].next.contains(&found.head);
        let round = distances
            .iter()
            .filter(|(node, _)| again(node))
            .fold(Cost::default(), |most, (_, cost)| most.or(*cost));
        let last = distances.values().fold(Cost::default(), |most, cost| most.or(*cost));
        let cost = round.times(rounds.saturating_sub(1)).and(last);
        let mut next = BTreeSet::new();
        for node in &found.body {
            if let Some(content) = self.nodes.remove(node) {
                next.extend(content.next.difference(&found.body));
            }
        }
        self.nodes.insert(found.head, Node { cost, marks: Vec::new(), next });
    }

    /// The longest path from `start` to the end of each block that it reaches within `part`, in which only `start` may
    /// be led back to.
    fn distances(&self, start: usize, part: &BTreeSet<usize>) -> BTreeMap<usize, Cost> {
        let mut order = Vec::new();
        let mut seen = BTreeSet::from([start]);
        let inner = |node: usize| -> Vec<usize> {
            let mut next = self.following(node);
            next.retain(|next| *next != start && part.contains(next));
            next
        };
        let mut stack = vec![(start, inner(start))];
        while let Some((node, rest)) = stack.last_mut() {
            let node = *node;
            match rest.pop() {
                Some(next) if seen.insert(next) => stack.push((next, inner(next))),
                Some(_) => {}
                None => {
                    order.push(node);
                    stack.pop();
                }
            }
        }
        let mut distances: BTreeMap<usize, Cost> = BTreeMap::new();
        if let Some(first) = self.nodes.get(&start) {
            distances.insert(start, first.cost);
        }
        for node in order.into_iter().rev() {
            let Some(so_far) = distances.get(&node).copied() else { continue };
            for next in inner(node) {
                let cost = so_far.and(self.nodes[&next].cost);
                let entry = distances.entry(next).or_default();
                *entry = entry.or(cost);
            }
        }
        distances
    }
}
