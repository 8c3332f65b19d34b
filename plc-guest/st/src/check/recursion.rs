//! Calls form no cycle (IEC 61131-3:2013, 6.6.1.2): so the stack that a task needs is known when the
//! program is built.

use std::collections::HashMap;

use super::Checker;
use crate::diagnostic::{Code, Diagnostic};
use crate::source::Span;

impl Checker<'_> {
    pub(super) fn refuse_recursion(&mut self) {
        let mut callees: HashMap<usize, Vec<(usize, Span)>> = HashMap::new();
        for (caller, callee, span) in std::mem::take(&mut self.calls) {
            callees.entry(caller).or_default().push((callee, span));
        }
        // Depth first with a stack of its own: a chain of calls may be as long as the project.
        let mut done = vec![false; self.units.len()];
        let mut open = vec![false; self.units.len()];
        for root in 0..self.units.len() {
            let mut path = vec![(root, 0)];
            while let Some((unit, next)) = path.last().copied() {
                if next == 0 {
                    if done[unit] {
                        path.pop();
                        continue;
                    }
                    open[unit] = true;
                }
                let call = callees.get(&unit).and_then(|calls| calls.get(next)).copied();
                if let Some(last) = path.last_mut() {
                    last.1 += 1;
                }
                match call {
                    Some((callee, span)) if open[callee] => {
                        self.tell_recursion(&path, callee, span)
                    }
                    Some((callee, _)) => path.push((callee, 0)),
                    None => {
                        open[unit] = false;
                        done[unit] = true;
                        path.pop();
                    }
                }
            }
        }
    }

    fn tell_recursion(&mut self, path: &[(usize, usize)], callee: usize, span: Span) {
        let start = path.iter().position(|(unit, _)| *unit == callee).unwrap_or(0);
        let mut names: Vec<&str> = path[start..]
            .iter()
            .take(8)
            .map(|(unit, _)| &*self.units[*unit].ast.name.text)
            .collect();
        names.push(&self.units[callee].ast.name.text);
        let found = match names.len() {
            2 => format!("`{}` calls itself", names[0]),
            _ => format!("a cycle of calls: {}", names.join(", ")),
        };
        self.tell(
            Diagnostic::new(Code::Recursion, span, found)
                .allowed("calls that form no cycle")
                .hint("use a loop"),
        );
    }
}
