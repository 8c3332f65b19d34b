//! Values that operators write and force in one partition: orders under way, and what is forced.
//!
//! The kernel keeps what is forced; here it is known by name. An order counts only when the kernel has answered it.

use std::collections::VecDeque;

use takt_abi::live::{Answer, Order, Point, Refusal as KernelRefusal};
use takt_scheduler::time::Nanos;

use super::link::{Link, NotSent};
use crate::control::protocol::{
    ErrorKind, EventKind, ForcedStatus, Named, PointValue, Refusal, raw_point,
};
use crate::report;

/// How long an answer is waited for.
const PATIENCE: Nanos = Nanos::from_millis(2_000);
/// Orders whose answers have not come.
const UNDER_WAY_MAX: usize = 32;
/// Values that are kept by name: as many as a kernel keeps.
const FORCED_MAX: usize = takt_abi::live::FORCES;

/// What a client asks to become of values.
#[derive(Clone, Debug)]
pub enum ValueOrder {
    /// Write once.
    Write(PointValue),
    /// Keep from now on.
    Force(PointValue),
    /// Keep no longer; none: any point.
    Release(Option<Point>),
}

/// What came of an order: for the client, and the event that it is.
pub type WriteResult = Result<(EventKind, String), Refusal>;

struct UnderWay {
    number: u32,
    ticket: u64,
    change: ValueOrder,
    /// None once the client has been told that no answer came. The kernel may carry the order out all the same.
    until: Option<Nanos>,
}

/// What is ordered of the values of a partition, and what is forced in it.
#[derive(Default)]
pub struct Writes {
    under_way: VecDeque<UnderWay>,
    forced: Vec<(Point, ForcedStatus)>,
    /// For the report.
    written_count: u64,
    forced_count: u64,
}

impl Writes {
    /// Orders a change, of which the client will hear by its ticket.
    ///
    /// # Errors
    /// Why it cannot be ordered.
    pub fn order(
        &mut self,
        ticket: u64,
        change: ValueOrder,
        link: &mut Link,
        now: Nanos,
    ) -> Result<(), Refusal> {
        let refused = |text: &str| Refusal::new(ErrorKind::Refused, text);
        if self.under_way.len() >= UNDER_WAY_MAX {
            return Err(refused("the PLC's kernel has not answered the orders before this one"));
        }
        let order = match &change {
            ValueOrder::Write(value) => Order::Write { point: value.point, value: value.value },
            ValueOrder::Force(value) => Order::Force { point: value.point, value: value.value },
            ValueOrder::Release(Some(point)) => Order::Release { point: *point },
            ValueOrder::Release(None) => Order::ReleaseAll,
        };
        let number = link.send(&order).map_err(|error| match error {
            NotSent::NoGuest => refused("the PLC's kernel does not run"),
            NotSent::Full => refused("the PLC's kernel has not taken the orders before this one"),
        })?;
        let until = Some(now.plus(PATIENCE));
        self.under_way.push_back(UnderWay { number, ticket, change, until });
        Ok(())
    }

    /// Takes an answer; the ticket of the change that it is about, and what came of it. What comes late is no less
    /// true, and an event.
    pub fn take(&mut self, number: u32, answer: &Answer, now: Nanos) -> Option<(u64, WriteResult)> {
        // The kernel answers in the order of the numbers: what it has passed over has lost its answer.
        let is_passed = |order: &UnderWay| number.wrapping_sub(order.number).cast_signed() > 0;
        self.under_way.retain(|order| order.until.is_some() || !is_passed(order));
        let Answer::Reply(reply) = answer else { return None };
        let at = self.under_way.iter().position(|order| order.number == number)?;
        let UnderWay { ticket, change, .. } = self.under_way.remove(at)?;
        let result = reply.map_err(refusal).map(|()| self.done(change, now));
        Some((ticket, result))
    }

    fn done(&mut self, change: ValueOrder, now: Nanos) -> (EventKind, String) {
        match change {
            ValueOrder::Write(PointValue { named: Named { name, text }, .. }) => {
                self.written_count += 1;
                (EventKind::Written, format!("{name} := {text}, written by an operator"))
            }
            ValueOrder::Force(PointValue { point, value, named: Named { name, text }, .. }) => {
                self.forced_count += 1;
                let told = format!("{name} := {text}, forced by an operator");
                self.forced.retain(|(forced, _)| *forced != point);
                self.forced.truncate(FORCED_MAX - 1);
                let (point_raw, since_ns) = (raw_point(point), now.0);
                let status = ForcedStatus { name, text, point: point_raw, value, since_ns };
                self.forced.push((point, status));
                (EventKind::Forced, told)
            }
            ValueOrder::Release(Some(point)) => {
                let at = self.forced.iter().position(|(forced, _)| *forced == point);
                let name = at.map(|at| self.forced.remove(at).1.name);
                let name = name.unwrap_or_else(|| "a value".to_owned());
                (EventKind::Released, format!("{name} is forced no longer, by an operator"))
            }
            ValueOrder::Release(None) => {
                let count = std::mem::take(&mut self.forced).len();
                let text =
                    format!("nothing is forced any longer, by an operator; it were {count} values");
                (EventKind::Released, text)
            }
        }
    }

    /// Orders that were not answered in time, or are too old for the kernel that runs.
    pub fn late(&mut self, now: Nanos, restarted: bool) -> Vec<(u64, WriteResult)> {
        let text = match restarted {
            true => "the PLC has started anew, and what it was ordered before is void",
            false => {
                "the PLC's kernel has not answered for 2 s: no window leaves it time for orders. If it still \
                 carries the order out, an event tells of it"
            }
        };
        let refused = || Err(Refusal::new(ErrorKind::Refused, text));
        let mut late = Vec::new();
        for order in &mut self.under_way {
            if order.until.take_if(|until| restarted || now >= *until).is_some() {
                late.push((order.ticket, refused()));
            }
        }
        if restarted {
            self.under_way.clear();
        }
        late
    }

    /// The kernel has started anew and forces nothing; what to tell, if that ends something.
    pub fn forget(&mut self) -> Option<String> {
        let count = std::mem::take(&mut self.forced).len();
        (count > 0).then(|| {
            format!("{count} values are forced no longer, because the PLC has started anew")
        })
    }

    /// Why a program must keep its version: in another one the places of these values can be those of other values.
    pub fn keep_version_of(&self, program: u8) -> Option<String> {
        let is_of = |point: &Point| point.range.program == program;
        let is_under_way = self.under_way.iter().any(|order| match &order.change {
            ValueOrder::Write(value) | ValueOrder::Force(value) => is_of(&value.point),
            ValueOrder::Release(_) => false,
        });
        let forced = self.forced.iter().filter(|(point, _)| is_of(point)).count();
        match forced {
            0 if is_under_way => Some(
                "the PLC's kernel has not answered an order to write or force a value of it"
                    .to_owned(),
            ),
            0 => None,
            count => Some(format!("{count} of its values are forced: release them first")),
        }
    }

    /// For the report, if operators did anything.
    pub fn told(&self) -> Option<report::Operator> {
        let forced = |(_, status): &(Point, ForcedStatus)| report::Forced {
            name: status.name.clone(),
            text: status.text.clone(),
            since_ns: status.since_ns,
        };
        (self.written_count + self.forced_count > 0).then(|| report::Operator {
            written: self.written_count,
            forced: self.forced_count,
            at_the_end: self.forced.iter().map(forced).collect(),
        })
    }

    /// What is forced.
    pub fn forced(&self) -> Vec<ForcedStatus> {
        self.forced.iter().map(|(_, status)| status.clone()).collect()
    }
}

fn refusal(refusal: KernelRefusal) -> Refusal {
    let text = match refusal {
        KernelRefusal::Unknown => "the PLC's kernel does not know this order",
        KernelRefusal::NoProgram => "the PLC's kernel has no such program",
        KernelRefusal::NoPlace => "the program has no such place",
        KernelRefusal::Full => "the PLC's kernel keeps 256 values forced at most",
        KernelRefusal::NotForced => "this value is not forced",
        KernelRefusal::Changing => {
            "the program changes to another version, or has one on trial: no value of it is written or forced until \
             the trial is over"
        }
        KernelRefusal::NotNow | KernelRefusal::Forced => "the PLC's kernel takes no such order now",
    };
    Refusal::new(ErrorKind::Refused, text)
}

#[cfg(test)]
mod tests {
    use super::*;
    use takt_abi::live::{Area, Range};

    #[test]
    fn what_is_forced_is_known_by_name_until_it_is_released() {
        let mut writes = Writes::default();
        let range = Range { program: 0, area: Area::Output, offset: 0, bytes: 1 };
        let value = |bit, text: &str| PointValue {
            partition: "plc".into(),
            point: Point::new(range, Some(bit)).unwrap(),
            value: 1,
            named: Named { name: format!("tank.q{bit}"), text: text.into() },
        };
        let now = Nanos::from_millis(5);
        for (bit, text) in [(0, "TRUE"), (1, "TRUE"), (0, "FALSE")] {
            writes.done(ValueOrder::Force(value(bit, text)), now);
        }
        let names = |writes: &Writes| -> Vec<String> {
            writes.forced().iter().map(|f| format!("{} {}", f.name, f.text)).collect()
        };
        assert_eq!(names(&writes), ["tank.q1 TRUE", "tank.q0 FALSE"]);
        let (kind, text) = writes.done(ValueOrder::Release(Some(value(1, "").point)), now);
        assert_eq!(kind, EventKind::Released);
        assert_eq!(text, "tank.q1 is forced no longer, by an operator");
        assert_eq!(names(&writes), ["tank.q0 FALSE"]);
        assert!(writes.forget().unwrap().starts_with("1 values"));
        assert_eq!((writes.forget(), names(&writes).len()), (None, 0));
    }

    #[test]
    fn an_order_that_is_carried_out_late_is_known_and_told_once() {
        let mut writes = Writes::default();
        let range = Range { program: 3, area: Area::Output, offset: 0, bytes: 1 };
        let point = Point::new(range, Some(0)).unwrap();
        let named = Named { name: "tank.q0".into(), text: "TRUE".into() };
        let value = PointValue { partition: "plc".into(), point, value: 1, named };
        let ordered = |number| UnderWay {
            number,
            ticket: 7,
            change: ValueOrder::Force(value.clone()),
            until: Some(PATIENCE),
        };
        writes.under_way.push_back(ordered(u32::MAX));
        assert!(writes.late(Nanos(PATIENCE.0 - 1), false).is_empty());
        assert_eq!(writes.late(PATIENCE, false).len(), 1);
        assert!(writes.late(Nanos::from_millis(9_000), false).is_empty());
        assert!(writes.keep_version_of(3).is_some_and(|text| text.contains("has not answered")));
        let done = writes.take(u32::MAX, &Answer::Reply(Ok(())), Nanos::from_millis(9_000));
        assert!(matches!(done, Some((7, Ok((EventKind::Forced, _))))));
        assert_eq!((writes.forced().len(), writes.under_way.len()), (1, 0));

        // An answer that is lost is not waited for after a later one has come; one that is not late yet is.
        writes.under_way.extend([ordered(u32::MAX), ordered(1)]);
        assert_eq!(writes.late(PATIENCE, false).len(), 2);
        writes.under_way.push_back(ordered(2));
        assert!(writes.take(3, &Answer::Reply(Ok(())), PATIENCE).is_none());
        assert_eq!(writes.under_way.len(), 1);
        assert_eq!(writes.late(Nanos(0), true).len(), 1);
        assert!(writes.under_way.is_empty());
    }
}
