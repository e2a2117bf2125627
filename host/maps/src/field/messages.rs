//! Gaussian belief propagation.
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
    /// h.
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
        let (diagonal, mean, precision) = (at.edges + own, at.total() / at.precision(), at.precision());
        at.pending += ((information - at.information).abs() + ((diagonal - at.diagonal) * mean).abs()) / precision;
        at.diagonal = diagonal;
        at.information = information;
        self.change(node);
        self.enqueue(node);
    }

    pub(super) fn mean(&self, node: usize) -> f64 {
        self.nodes[node].total() / self.nodes[node].precision()
    }

    pub(super) fn precision(&self, node: usize) -> f64 {
        self.nodes[node].precision()
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

    /// Messages whose beliefs are these means: at the fixed point, both messages of an edge follow from the means of its ends.
    ///
    /// From h(i→j) = a (Pᵢ xᵢ - h(j→i)) and its mirror image, with a = λ / P(i without j) and b = λ / P(j without i):
    /// h(i→j) = a (Pᵢ xᵢ - b Pⱼ xⱼ) / (1 - a b).
    pub(super) fn set_means(&mut self, lattice: &Lattice, means: &[f64]) {
        self.settle_precisions(lattice);
        for node in 0..self.nodes.len() {
            // Each edge once: in +x and +y.
            for direction in 0..2 {
                let near = lattice.neighbours[node][direction];
                if near == NONE {
                    continue;
                }
                let near = near as usize;
                let (from, to) = (&self.nodes[node], &self.nodes[near]);
                let precision = [from.precision(), to.precision()];
                let a = self.smoothness / (precision[0] - from.precision_in[direction]);
                let b = self.smoothness / (precision[1] - to.precision_in[back(direction)]);
                let [mine, theirs] = [precision[0] * means[node], precision[1] * means[near]];
                let scale = (1.0 - a * b).recip();
                self.nodes[near].information_in[back(direction)] = a * (mine - b * theirs) * scale;
                self.nodes[node].information_in[direction] = b * (theirs - a * mine) * scale;
            }
        }
        // What the means lack of the fixed point is between them and the beliefs that these messages make.
        for (node, mean) in self.nodes.iter_mut().zip(means) {
            node.pending = (node.total() / node.precision() - mean).abs();
        }
        self.queue.clear();
        self.is_queued.fill(false);
        let due = self.nodes.iter().enumerate().filter(|(_, node)| node.pending > 0.0);
        for (index, _) in due {
            self.is_queued[index] = true;
            self.queue.push_back(index as u32);
        }
    }
}
