//! A program while it is put together: names that are used once, nodes that are made when they are first needed.

use dynocal_export::characteristic::identifier;
use dynocal_export::program::{Input, NodeId, Op, Output, Program};
use dynocal_numerics::interval::Interval;

/// A program that grows.
pub(super) struct Build {
    pub(super) program: Program,
    /// Names that are taken.
    taken: Vec<String>,
}

impl Build {
    pub(super) fn new(sample_time_s: f64) -> Self {
        let program = Program { sample_time_s, inputs: Vec::new(), nodes: Vec::new(), outputs: Vec::new() };
        Self { program, taken: Vec::new() }
    }

    /// `name` as an identifier that nothing else has.
    fn free(&mut self, name: &str) -> String {
        let base = identifier(name);
        let mut candidate = base.clone();
        let mut k = 2;
        while self.taken.contains(&candidate) {
            candidate = format!("{base}_{k}");
            k += 1;
        }
        self.taken.push(candidate.clone());
        candidate
    }

    /// A node; its name is made free.
    pub(super) fn node(&mut self, name: &str, op: Op) -> NodeId {
        let name = self.free(name);
        self.program.push(&name, op)
    }

    /// A channel that enters, as a node.
    pub(super) fn input(&mut self, name: &str, unit: &str, start: f64, range: Option<Interval>) -> NodeId {
        let own = self.free(name);
        let place = self.program.inputs.len();
        let (unit, description) = (unit.to_string(), name.to_string());
        self.program.inputs.push(Input { name: own, unit, description, start, range });
        self.node(&format!("{name}_in"), Op::Input(place))
    }

    /// A channel that leaves.
    pub(super) fn output(&mut self, name: &str, unit: &str, node: NodeId) {
        let own = self.free(name);
        let (unit, description) = (unit.to_string(), name.to_string());
        self.program.outputs.push(Output { name: own, unit, description, node });
    }
}
