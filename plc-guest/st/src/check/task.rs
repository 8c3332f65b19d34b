//! A TASK of a CONFIGURATION: what its properties say.

use super::body::Body;
use super::{Checker, Entry};
use crate::diagnostic::{Code, Diagnostic};
use crate::hir::{Constant, Elementary, Event, TaskKind};
use crate::source::Span;
use crate::syntax::ast::{self, Expression, ExpressionKind};

/// What the properties of a task say.
#[derive(Default)]
pub(super) struct Properties {
    pub(super) interval: Option<(u64, Span)>,
    pub(super) single: Option<Event>,
    pub(super) priority: u8,
    pub(super) offset: u64,
    pub(super) budget: u64,
    pub(super) deadline: u64,
}

impl<'a> Checker<'a> {
    pub(super) fn task_kind(&mut self, task: &'a ast::Task) -> Option<(TaskKind, Properties)> {
        let mut properties = Properties::default();
        let mut complete = true;
        let mut priority_given = false;
        for (at, (name, value)) in task.properties.iter().enumerate() {
            let done = match &*name.key {
                key if task.properties[..at].iter().any(|(other, _)| &*other.key == key) => {
                    let found = format!("a second {key} of the task `{}`", task.name.text);
                    self.error(Code::InvalidTask, name.span, found);
                    None
                }
                "INTERVAL" => self.duration(value).map(|interval| {
                    properties.interval = Some((interval, value.span));
                }),
                "OFFSET" => self.duration(value).map(|offset| properties.offset = offset),
                "BUDGET" => self.limit(name, value).map(|budget| properties.budget = budget),
                "DEADLINE" => {
                    self.limit(name, value).map(|deadline| properties.deadline = deadline)
                }
                "SINGLE" | "CHANNEL" if properties.single.is_some() => {
                    let found = format!("a second event of the task `{}`", task.name.text);
                    let one = Diagnostic::new(Code::InvalidTask, name.span, found);
                    self.tell(one.allowed("either SINGLE or CHANNEL, once"));
                    None
                }
                "SINGLE" => {
                    self.event(value).map(|source| properties.single = Some(Event::Rise(source)))
                }
                "CHANNEL" => {
                    let port = self.port_of_task(value);
                    port.map(|port| properties.single = Some(Event::Channel(port)))
                }
                "PRIORITY" => {
                    priority_given = true;
                    let number = Body::of_constants(self).constant_integer(value);
                    number.and_then(|number| match u8::try_from(number) {
                        Ok(number) => {
                            properties.priority = number;
                            Some(())
                        }
                        Err(_) => {
                            let found = format!("the priority {number}");
                            let one = Diagnostic::new(Code::InvalidTask, value.span, found);
                            self.tell(one.allowed("0 (the most urgent) to 255"));
                            None
                        }
                    })
                }
                _ => {
                    let found = format!("a task has no `{}`", name.text);
                    let one = Diagnostic::new(Code::InvalidTask, name.span, found);
                    self.tell(one.allowed(
                        "INTERVAL, SINGLE, PRIORITY; of Takt's own CHANNEL, OFFSET, BUDGET, DEADLINE",
                    ));
                    None
                }
            };
            complete &= done.is_some();
        }
        if !priority_given {
            let found = format!("the task `{}` without PRIORITY", task.name.text);
            let one = Diagnostic::new(Code::InvalidTask, task.name.span, found);
            self.tell(one.allowed("`PRIORITY := n`, 0 is the most urgent"));
            return None;
        }
        let kind = match (properties.single.clone(), properties.interval) {
            (Some(source), Some((minimum_ns, _))) if minimum_ns > 0 => {
                let offset = task.properties.iter().find(|(name, _)| &*name.key == "OFFSET");
                if let Some((offset, _)) = offset {
                    let found = format!("an OFFSET of the event task `{}`", task.name.text);
                    let one = Diagnostic::new(Code::InvalidTask, offset.span, found);
                    self.tell(one.allowed("OFFSET of a task with a period"));
                    return None;
                }
                TaskKind::Event { source, minimum_ns }
            }
            // Without it nothing could be said of how much time the other tasks have.
            (Some(_), interval) => {
                let span = interval.map_or(task.name.span, |(_, span)| span);
                let found = format!("no least time between two releases of `{}`", task.name.text);
                let one = Diagnostic::new(Code::InvalidTask, span, found);
                let allowed = "with SINGLE or CHANNEL also INTERVAL, such as `INTERVAL := T#10ms`";
                self.tell(one.allowed(allowed));
                return None;
            }
            (None, Some((0, span))) => {
                let one = Diagnostic::new(Code::InvalidTask, span, "an interval of 0");
                self.tell(one.hint("a program without a task runs whenever nothing else does"));
                return None;
            }
            (None, Some((period_ns, _))) => {
                TaskKind::Cyclic { period_ns, offset_ns: properties.offset }
            }
            (None, None) if complete => {
                let found = format!("the task `{}` is never released", task.name.text);
                let one = Diagnostic::new(Code::InvalidTask, task.name.span, found);
                self.tell(one.allowed("INTERVAL (its period), SINGLE or CHANNEL (its event)"));
                return None;
            }
            (None, None) => return None,
        };
        complete.then_some((kind, properties))
    }

    /// A duration that is not 0 either, which means in an image that there is no such limit.
    fn limit(&mut self, name: &ast::Name, value: &'a Expression) -> Option<u64> {
        let duration = self.duration(value)?;
        if duration == 0 {
            let found = format!("a {} of 0", name.key);
            let one = Diagnostic::new(Code::InvalidTask, value.span, found);
            self.tell(one.hint(format!("leave it out: so the task has no {}", name.key)));
            return None;
        }
        Some(duration)
    }

    /// A duration that is not negative, in nanoseconds.
    fn duration(&mut self, value: &'a Expression) -> Option<u64> {
        let time = self.elementary(Elementary::Time);
        let constant = Body::of_constants(self).constant(value, time)?;
        match constant {
            Constant::Integer(number) if number >= 0 => u64::try_from(number).ok(),
            _ => {
                self.error(Code::InvalidTask, value.span, "a negative duration");
                None
            }
        }
    }

    /// The name of the BOOL whose rising edge releases a task.
    fn event(&mut self, value: &'a Expression) -> Option<String> {
        let allowed = "the name of a global BOOL or a bit address such as `%IX0.0`";
        let bool_type = self.elementary(Elementary::Bool);
        let global = match &value.kind {
            ExpressionKind::Address(address) => self.direct(address),
            ExpressionKind::Name(name) => match self.names.get(&name.key) {
                Some(Entry::Global(index)) => {
                    let entry = &mut self.globals[*index];
                    entry.read = true;
                    entry.id.zip(entry.ty)
                }
                _ => None,
            },
            _ => None,
        };
        match global {
            Some((id, ty)) if ty == bool_type => Some(self.program.global(id).name.clone()),
            _ => {
                let found = format!("`{}` as an event", self.sources.text(value.span));
                self.tell(Diagnostic::new(Code::InvalidTask, value.span, found).allowed(allowed));
                None
            }
        }
    }
}
