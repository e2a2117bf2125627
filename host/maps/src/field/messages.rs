//! Gaussian belief propagation.
//!
//! Messages carry a correction of known means (0 at first), so that they can continue from the result of a solve.
//!
//! A message has a precision P ≤ 0 and an information P·μ. These two are kept, because the receiver adds both up. With
//! Aᵢⱼ = -λ, the message from i to j is P = -λ² / P(i without j) and P·μ = λ / P(i without j) · h(i without j).

use std::collections::{BinaryHeap, VecDeque};

use super::lattice::{Lattice, NONE, back};

/// Result of a propagation.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Spent {
    /// Number of cells that sent messages to their neighbours.
    pub updates: usize,
    /// True when no cell remains whose mean has changed by more than the threshold since it last sent.
    pub settled: bool,
}

#[derive(Clone, Copy, Debug, Default)]
struct Node {
    /// Diagonal of A, and its part that comes from edges.
    diagonal: f64,
    edges: f64,
    /// Caller's h, and the mean that messages correct.
    source: f64,
    base: f64,
    /// Product of λ and the sum of the neighbours' base.
    around: f64,
    /// Residual with which the base was accepted.
    accepted: f64,
    /// Residual of the base beyond that: the right side that the messages solve for.
    information: f64,
    /// Received messages, by the direction that they came from.
    precision_in: [f64; 4],
    information_in: [f64; 4],
    /// Bound of the change of the mean since this node last sent. It adds up small changes, each of which would be
    /// below the threshold.
    pending: f64,
}

impl Node {
    fn precision(&self) -> f64 {
        self.diagonal + self.precision_in.iter().sum::<f64>()
    }

    fn residual(&self) -> f64 {
        self.source + self.around - self.diagonal * self.base - self.accepted
    }

    fn total(&self) -> f64 {
        self.information + self.information_in.iter().sum::<f64>()
    }
}

#[derive(Clone, Debug)]
pub(super) struct Messages {
    nodes: Vec<Node>,
    /// Smoothness λ of the field.
    smoothness: f64,
    queue: VecDeque<u32>,
    is_queued: Vec<bool>,
    /// Nodes whose diagonal or received precisions changed since they last sent to the fixed point of precisions.
    changed: VecDeque<u32>,
    is_changed: Vec<bool>,
}

/// Change of a message's precision, relative to λ, that is not passed on. Changes in a corridor shrink by 1 - 2 √(prior
/// / λ) from cell to cell, 0.97 for the weights of a gas map: the sum of all later changes is 30 times this.
const SETTLED: f64 = 1e-14;

/// Entry of the queue of residuals. The bits of a non-negative number have its order.
type Entry = (u64, u32);

impl Messages {
    pub(super) fn new(lattice: &Lattice, smoothness: f64, prior: f64) -> Self {
        let nodes = lattice.nodes();
        let mut messages = Self {
            nodes: vec![Node::default(); nodes],
            smoothness,
            queue: VecDeque::new(),
            is_queued: vec![false; nodes],
            changed: (0..nodes as u32).collect(),
            is_changed: vec![true; nodes],
        };
        for (node, neighbours) in messages.nodes.iter_mut().zip(&lattice.neighbours) {
            let edges = neighbours.iter().filter(|near| **near != NONE).count();
            node.edges = smoothness * edges as f64;
            node.diagonal = prior + node.edges;
        }
        messages.settle_precisions(lattice);
        messages
    }

    /// Sets a node's own energy: the diagonal of A without edges, and h.
    pub(super) fn set(&mut self, node: usize, own: f64, information: f64) {
        let at = &mut self.nodes[node];
        let (before, correction, precision) = (*at, at.total() / at.precision(), at.precision());
        at.diagonal = at.edges + own;
        at.source = information;
        at.information = at.residual();
        let [steeper, pulled] = [at.diagonal - before.diagonal, at.information - before.information];
        // Bound of the change of the mean: h changes by `pulled`, and the diagonal by `steeper` at the present
        // correction.
        at.pending += (pulled.abs() + (steeper * correction).abs()) / precision;
        self.change(node);
        self.enqueue(node);
    }

    pub(super) fn mean(&self, node: usize) -> f64 {
        let at = &self.nodes[node];
        at.base + at.total() / at.precision()
    }

    /// Returns the precisions of all beliefs at their fixed point.
    pub(super) fn precisions(&self, lattice: &Lattice) -> Vec<f64> {
        let mut settled = self.clone();
        settled.settle_precisions(lattice);
        settled.nodes.iter().map(Node::precision).collect()
    }

    fn change(&mut self, node: usize) {
        if !self.is_changed[node] {
            self.is_changed[node] = true;
            self.changed.push_back(node as u32);
        }
    }

    fn enqueue(&mut self, node: usize) {
        if !self.is_queued[node] {
            self.is_queued[node] = true;
            self.queue.push_back(node as u32);
        }
    }

    pub(super) fn wildfire(&mut self, lattice: &Lattice, threshold: f64, budget: usize) -> Spent {
        let mut updates = 0;
        while updates < budget
            && let Some(node) = self.queue.pop_front()
        {
            self.is_queued[node as usize] = false;
            if self.nodes[node as usize].pending > threshold {
                updates += 1;
                for near in self.send(lattice, node as usize).into_iter().filter(|near| *near != NONE) {
                    if self.nodes[near as usize].pending > threshold {
                        self.enqueue(near as usize);
                    }
                }
            }
        }
        Spent { updates, settled: self.queue.is_empty() && self.nodes.iter().all(|node| node.pending <= threshold) }
    }

    pub(super) fn settle(&mut self, lattice: &Lattice, threshold: f64, budget: usize) -> Spent {
        let due = self.nodes.iter().enumerate().filter(|(_, node)| node.pending > threshold);
        let mut heap: BinaryHeap<Entry> = due.map(|(index, node)| (node.pending.to_bits(), index as u32)).collect();
        let mut updates = 0;
        while updates < budget
            && let Some((bits, node)) = heap.pop()
        {
            let pending = self.nodes[node as usize].pending;
            // Skipped: entered again with a greater residual, or sent already.
            if pending <= threshold || pending.to_bits() != bits {
                continue;
            }
            updates += 1;
            for near in self.send(lattice, node as usize).into_iter().filter(|near| *near != NONE) {
                let pending = self.nodes[near as usize].pending;
                if pending > threshold {
                    heap.push((pending.to_bits(), near));
                }
            }
        }
        let settled = self.nodes.iter().all(|node| node.pending <= threshold);
        if settled {
            self.queue.clear();
            self.is_queued.fill(false);
        }
        Spent { updates, settled }
    }

    /// Sends a node's messages to all neighbours, which are returned.
    fn send(&mut self, lattice: &Lattice, node: usize) -> [u32; 4] {
        let at = &mut self.nodes[node];
        at.pending = 0.0;
        let (at, precision, total) = (*at, at.precision(), at.total());
        let neighbours = lattice.neighbours[node];
        for (direction, near) in neighbours.into_iter().enumerate().filter(|(_, near)| *near != NONE) {
            // Without what this neighbour has sent itself: a message must not return to its sender.
            let share = self.smoothness / (precision - at.precision_in[direction]);
            let message = [-self.smoothness * share, share * (total - at.information_in[direction])];
            let to = &mut self.nodes[near as usize];
            let from = back(direction);
            let change = [message[0] - to.precision_in[from], message[1] - to.information_in[from]];
            to.precision_in[from] = message[0];
            to.information_in[from] = message[1];
            let precision = to.precision();
            to.pending += (change[1].abs() + (change[0] * to.total() / precision).abs()) / precision;
            if change[0].abs() > SETTLED * self.smoothness {
                self.change(near as usize);
            }
        }
        neighbours
    }

    /// Brings the precisions of all messages to their fixed point, which is independent of the readings' values.
    fn settle_precisions(&mut self, lattice: &Lattice) {
        while let Some(node) = self.changed.pop_front() {
            self.is_changed[node as usize] = false;
            let at = self.nodes[node as usize];
            let precision = at.precision();
            for (direction, near) in lattice.neighbours[node as usize].into_iter().enumerate() {
                if near == NONE {
                    continue;
                }
                let message = -self.smoothness * self.smoothness / (precision - at.precision_in[direction]);
                let received = &mut self.nodes[near as usize].precision_in[back(direction)];
                // The threshold ends this: changes shrink from cell to cell (see `SETTLED`).
                let change = message - std::mem::replace(received, message);
                if change.abs() > SETTLED * self.smoothness {
                    self.change(near as usize);
                }
            }
        }
    }

    /// Sets the means that messages correct from now on: they start again at zero, on the residual of the means.
    ///
    /// Where `is_solved`, their residual is accepted: a belief without its neighbours' messages would make an error of
    /// λ over the prior times as much of it. Messages that have these means as beliefs also follow in closed form from
    /// both ends of each edge. That was tried and given up: it enlarged the errors of means by λ over the prior where
    /// no reading is near.
    pub(super) fn set_means(&mut self, lattice: &Lattice, means: &[f64], is_solved: bool) {
        self.queue.clear();
        for (index, node) in self.nodes.iter_mut().enumerate() {
            node.base = means[index];
            node.around = self.smoothness * lattice.near(index).map(|near| means[near]).sum::<f64>();
            // `residual` subtracts what is accepted, so that must be cleared first.
            node.accepted = 0.0;
            node.accepted = if is_solved { node.residual() } else { 0.0 };
            node.information = if is_solved { 0.0 } else { node.residual() };
            node.information_in = [0.0; 4];
            node.pending = (node.information / node.precision()).abs();
            self.is_queued[index] = node.pending > 0.0;
            if self.is_queued[index] {
                self.queue.push_back(index as u32);
            }
        }
    }
}
