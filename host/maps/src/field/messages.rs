//! Gaussian belief propagation.
//!
//! Messages carry a correction of means that are known (0 at first), so that a solve can be handed to them and they go on from it.
//!
//! A message has a precision P ≤ 0 and an information P·μ, which is what is kept: both are sums at the receiver. With
//! Aᵢⱼ = -λ, the message from i to j is P = -λ² / P(i without j) and P·μ = λ / P(i without j) · h(i without j).

use std::collections::{BinaryHeap, VecDeque};

use super::lattice::{Lattice, NONE, back};

/// What propagation has done.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Spent {
    /// Cells that sent messages to their neighbours.
    pub updates: usize,
    /// Whether no cell is left whose mean has changed by more than the threshold since it last sent.
    pub settled: bool,
}

#[derive(Clone, Copy, Debug, Default)]
struct Node {
    /// Diagonal of A, and what of it is the edges'.
    diagonal: f64,
    edges: f64,
    /// h of the caller, and the mean that messages correct.
    source: f64,
    base: f64,
    /// λ times the sum of the neighbours' base.
    around: f64,
    /// Residual that the base was accepted with.
    accepted: f64,
    /// Residual of the base beyond that: what the messages solve for.
    information: f64,
    /// Received messages, by the direction they came from.
    precision_in: [f64; 4],
    information_in: [f64; 4],
    /// Bound of the change of the mean since this node last sent; sums small changes, which would be lost one by one.
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
    /// λ: smoothness.
    smoothness: f64,
    queue: VecDeque<u32>,
    is_queued: Vec<bool>,
    /// Nodes whose diagonal or received precisions changed since they last sent to the fixed point of precisions.
    changed: VecDeque<u32>,
    is_changed: Vec<bool>,
}

/// Change of a message's precision, relative to λ, that is not passed on. Changes in a corridor shrink by 1 - 2 √(prior / λ) from
/// cell to cell, 0.97 for the weights of a gas map: what is left of those to come is 30 times this.
const SETTLED: f64 = 1e-14;

/// An entry of the queue by residuals: the bits of a number that is not negative are in its order.
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

    /// A node's own energy: the diagonal of A without edges, and h.
    pub(super) fn set(&mut self, node: usize, own: f64, information: f64) {
        let at = &mut self.nodes[node];
        let (before, correction, precision) = (*at, at.total() / at.precision(), at.precision());
        at.diagonal = at.edges + own;
        at.source = information;
        at.information = at.residual();
        let [steeper, pulled] = [at.diagonal - before.diagonal, at.information - before.information];
        at.pending += (pulled.abs() + (steeper * correction).abs()) / precision;
        self.change(node);
        self.enqueue(node);
    }

    pub(super) fn mean(&self, node: usize) -> f64 {
        let at = &self.nodes[node];
        at.base + at.total() / at.precision()
    }

    /// Precisions of all beliefs at their fixed point.
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
            // Entered again with a greater residual since, or sent already.
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

    /// Messages of a node to all neighbours, which are returned.
    fn send(&mut self, lattice: &Lattice, node: usize) -> [u32; 4] {
        let at = &mut self.nodes[node];
        at.pending = 0.0;
        let (at, precision, total) = (*at, at.precision(), at.total());
        let neighbours = lattice.neighbours[node];
        for (direction, near) in neighbours.into_iter().enumerate().filter(|(_, near)| *near != NONE) {
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

    /// Precisions of all messages, at their fixed point: independent of the readings' values.
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
                let change = message - std::mem::replace(received, message);
                if change.abs() > SETTLED * self.smoothness {
                    self.change(near as usize);
                }
            }
        }
    }

    /// Means that messages correct from now on: they start again, at nothing, on the residual of the means.
    ///
    /// Where `is_solved`, the residual they have is accepted: a belief that has not heard from its neighbours would make an error of λ
    /// over the prior times as much of it. Messages with these means as beliefs also follow in closed form from both ends of each edge; that enlarged the errors of
    /// means by λ over the prior where no reading is near, and was given up.
    pub(super) fn set_means(&mut self, lattice: &Lattice, means: &[f64], is_solved: bool) {
        self.queue.clear();
        for (index, node) in self.nodes.iter_mut().enumerate() {
            node.base = means[index];
            node.around = self.smoothness * lattice.near(index).map(|near| means[near]).sum::<f64>();
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
