//! CHANNEL_READ and CHANNEL_WRITE: messages of a port, as a variable of the program.
//!
//! A port is declared by its use: the first call that names it says which way its messages go and how long they are. A
//! test is the other partition: what it writes, the program reads.

use crate::check::body::Body;
use crate::check::expression::Operand;
use crate::check::names::similar;
use crate::check::types::is_integer;
use crate::check::unit::is_part;
use crate::check::{Checker, PortEntry};
use crate::diagnostic::{Code, Diagnostic};
use crate::hir::{
    Channel, Constant, Conversion, Direction, Elementary, Expr, ExprKind, Intrinsic, Place, Port,
    StructureKind, Type, TypeId,
};
use crate::source::Span;
use crate::syntax::ast::{Argument, Binding, Expression, Name};

const READ: &str = "CHANNEL_READ";
const WRITE: &str = "CHANNEL_WRITE";
/// A name in the tables of a partition has so many bytes, and a zero.
const NAME_BYTES: usize = 31;

/// How these functions are called.
pub(super) const FORMS: [(&str, &str); 2] =
    [(READ, "CHANNEL_READ(PORT, MESSAGE)"), (WRITE, "CHANNEL_WRITE(PORT, MESSAGE, LENGTH)")];

/// Whether a function of this key talks to a channel. Its result need not be used.
pub(in crate::check) fn is_channel(key: &str) -> bool {
    FORMS.iter().any(|(name, _)| *name == key)
}

/// The arguments of a call, by their places.
struct Given<'a> {
    port: &'a Expression,
    message: &'a Expression,
    length: Option<&'a Expression>,
}

impl<'a> Body<'_, 'a> {
    /// A call of one of both. Its value is a LINT.
    pub(super) fn channel(
        &mut self,
        name: &Name,
        arguments: &'a [Argument],
        span: Span,
    ) -> Option<Operand> {
        let reads = &*name.key == READ;
        let Some(Given { port, message, length }) = given(arguments, reads) else {
            let found = format!("these arguments of `{}`", name.text);
            let one = Diagnostic::new(Code::WrongArguments, span, found);
            self.tell(one.allowed(match reads {
                true => "`CHANNEL_READ(PORT := 'name', MESSAGE := variable)`",
                false => {
                    "`CHANNEL_WRITE(PORT := 'name', MESSAGE := variable)`, and `LENGTH := bytes` \
                     for a part of it"
                }
            }));
            return None;
        };
        let known = self.port_name(port);
        let place = if reads { self.write_place(message) } else { self.read_place(message) };
        let (place, known) = (place?, known?);
        let bytes = self.message_bytes(&place, message.span, reads)?;
        let length = match length {
            Some(length) => self.length(length, bytes)?,
            None => {
                let long = self.elementary(Elementary::Lint);
                self.integer(long, bytes.into(), span)
            }
        };
        let peer = self.in_test();
        // What a test writes comes in for the program.
        let direction = if reads == peer { Direction::Out } else { Direction::In };
        let port = self.checker.port(&known, direction, bytes, port.span, peer)?;
        let channel = Channel { port, peer };
        let ty = self.checker.program.types.reference(place.ty);
        let message = self.expr(ty, ExprKind::Reference(place), message.span);
        let long = self.elementary(Elementary::Lint);
        let (intrinsic, list) = match reads {
            true => (Intrinsic::ChannelRead(channel), vec![message]),
            false => (Intrinsic::ChannelWrite(channel), vec![message, length]),
        };
        Some(self.intrinsic(intrinsic, list, long, span))
    }

    /// The name of a port, which is known when the program is built.
    pub(in crate::check) fn port_name(&mut self, value: &'a Expression) -> Option<String> {
        let ty = self.checker.program.types.string(u16::MAX);
        let Constant::String(bytes) = self.constant(value, ty)? else { return None };
        let name: String = bytes.into_iter().map(char::from).collect();
        let good = |c: char| c.is_ascii_alphanumeric() || "_-.".contains(c);
        if name.is_empty() || name.len() > NAME_BYTES || !name.chars().all(good) {
            let found = format!("the port `{}`", name.escape_debug());
            let one = Diagnostic::new(Code::WrongArguments, value.span, found);
            let allowed = format!("1 to {NAME_BYTES} letters A to Z, digits, `_`, `-` and `.`");
            self.tell(one.allowed(allowed));
            return None;
        }
        Some(name)
    }

    /// The bytes of a variable that can be a message.
    fn message_bytes(&mut self, place: &Place, span: Span, reads: bool) -> Option<u32> {
        let is_bit = match place.root {
            crate::hir::Root::Global(id) => self.checker.program.global(id).storage.bit.is_some(),
            _ => false,
        };
        let wrong = if is_part(place) || is_bit {
            Some("a bit or a part of a variable")
        } else {
            self.unfit(place.ty, reads)
        };
        if let Some(what) = wrong {
            let found = format!("{what} as a message");
            let mut one = Diagnostic::new(Code::TypeMismatch, span, found).allowed(
                "a variable of an elementary type, an enumeration, STRING or WSTRING, and arrays and \
                 structures of them",
            );
            if reads && what.contains("subrange") {
                one = one.hint("receive the base type, and assign it: so its value is checked");
            }
            self.tell(one);
            return None;
        }
        let bytes = self.checker.program.types.size(place.ty);
        let most = takt_program::limit::MESSAGE_BYTES;
        if bytes == 0 || bytes > most {
            let one =
                Diagnostic::new(Code::OutOfRange, span, format!("a message of {bytes} bytes"));
            self.tell(one.allowed(format!("1..{most}")));
            return None;
        }
        Some(bytes)
    }

    /// Why a type is none of a message, if so: what has a meaning in this program only, and what a stranger could
    /// give a value that the type does not have.
    fn unfit(&self, ty: TypeId, reads: bool) -> Option<&'static str> {
        match self.checker.program.types.get(ty) {
            Type::Reference { .. } => Some("a reference"),
            Type::OpenArray { .. } => Some("an ARRAY[*]"),
            Type::Subrange { .. } if reads => Some("a subrange"),
            Type::Array { element, .. } => self.unfit(*element, reads),
            Type::Structure(structure) if structure.kind != StructureKind::Struct => {
                Some("an instance")
            }
            Type::Structure(structure) => {
                structure.fields.iter().find_map(|field| self.unfit(field.ty, reads))
            }
            _ => None,
        }
    }

    /// A length within the message; another one traps.
    fn length(&mut self, length: &'a Expression, bytes: u32) -> Option<Expr> {
        let operand = self.operand(length, None)?;
        let operand = self.without_subrange(operand, length.span);
        let ty = operand.expr.ty;
        if !self.plain(ty).is_some_and(is_integer) {
            let found = format!("{} as a length", self.type_name(ty));
            let one = Diagnostic::new(Code::TypeMismatch, length.span, found);
            self.tell(one.allowed("an integer"));
            return None;
        }
        if let Some(Constant::Integer(value)) = operand.constant()
            && !(1..=i128::from(bytes)).contains(value)
        {
            let found = format!("the length {value} of a message of {bytes} bytes");
            let one = Diagnostic::new(Code::OutOfRange, length.span, found);
            self.tell(one.allowed(format!("1..{bytes}")));
            return None;
        }
        let operand = self.as_long(operand, length.span)?;
        let types = &mut self.checker.program.types;
        let fitting = types.subrange("LENGTH", Elementary::Lint, 1, bytes.into());
        let checked = self.convert(Conversion::Check, operand, fitting, length.span);
        let long = self.elementary(Elementary::Lint);
        Some(self.convert(Conversion::Value, checked, long, length.span))
    }
}

fn given(arguments: &[Argument], reads: bool) -> Option<Given<'_>> {
    let names: &[&str] = if reads { &["PORT", "MESSAGE"] } else { &["PORT", "MESSAGE", "LENGTH"] };
    let mut values = [None; 3];
    for (at, argument) in arguments.iter().enumerate() {
        let at = match &argument.name {
            None => at,
            Some((formal, Binding::Input)) => {
                names.iter().position(|name| *name == &*formal.key)?
            }
            Some(_) => return None,
        };
        let slot = values[..names.len()].get_mut(at).filter(|slot| slot.is_none())?;
        *slot = Some(argument.value.as_ref()?);
    }
    let [port, message, length] = values;
    Some(Given { port: port?, message: message?, length })
}

impl<'a> Checker<'a> {
    /// The number of a port, which is new or used as before.
    fn port(
        &mut self,
        name: &str,
        direction: Direction,
        bytes: u32,
        span: Span,
        peer: bool,
    ) -> Option<u32> {
        let same = |port: &Port| port.name.eq_ignore_ascii_case(name);
        let Some(number) = self.program.ports.iter().position(same) else {
            let most = takt_program::limit::PORTS as usize;
            if self.program.ports.len() >= most {
                let found = format!("port {} of this program", most + 1);
                let one = Diagnostic::new(Code::OutOfRange, span, found);
                self.tell(one.allowed(format!("at most {most}")));
                return None;
            }
            self.program.ports.push(Port { name: name.to_owned(), direction, bytes });
            self.ports.push(PortEntry { span, used: !peer });
            return Some(self.ports.len() as u32 - 1);
        };
        self.ports[number].used |= !peer;
        let (port, first) = (&self.program.ports[number], self.ports[number].span);
        let way = |direction| match direction {
            Direction::In => "read",
            Direction::Out => "written",
        };
        let found = if port.name != name {
            format!("the port `{name}`, which is `{}` elsewhere", port.name)
        } else if port.direction != direction {
            let there = way(port.direction);
            match peer {
                true => format!("the port `{name}` is {there} by the program and by this test"),
                false => {
                    format!("the port `{name}` is {} here and {there} elsewhere", way(direction))
                }
            }
        } else if port.bytes != bytes {
            format!("a message of {bytes} bytes at the port `{name}`, which has {}", port.bytes)
        } else {
            return Some(number as u32);
        };
        self.tell(
            Diagnostic::new(Code::TypeMismatch, span, found)
                .allowed("one spelling, one direction and one size for each port")
                .hint("a shorter message is written with LENGTH")
                .related(first, "the port is used here"),
        );
        None
    }

    /// The port at which the messages come that release a task.
    pub(in crate::check) fn port_of_task(&mut self, value: &'a Expression) -> Option<String> {
        let name = Body::of_constants(self).port_name(value)?;
        let ports = self.program.ports.iter().zip(&self.ports);
        let mut inputs = ports
            .filter(|(port, entry)| entry.used && port.direction == Direction::In)
            .map(|(port, _)| &*port.name);
        if inputs.clone().any(|port| port == name) {
            return Some(name);
        }
        let found = format!("no program reads the port `{name}`");
        let mut one = Diagnostic::new(Code::InvalidTask, value.span, found)
            .allowed("a port of a CHANNEL_READ of this project");
        if let Some(similar) = similar(&name.to_ascii_uppercase(), &mut inputs) {
            one = one.hint(format!("did you mean `{similar}`?"));
        }
        self.tell(one);
        None
    }

    /// Refuses ports of which tests alone know.
    pub(in crate::check) fn refuse_unused_ports(&mut self) {
        let of_tests = |(_, entry): &(&Port, &PortEntry)| !entry.used;
        let ports = self.program.ports.iter().zip(&self.ports);
        let unused: Vec<(String, Span)> =
            ports.filter(of_tests).map(|(port, entry)| (port.name.clone(), entry.span)).collect();
        for (name, span) in unused {
            let found = format!("the program has no port `{name}`");
            let one = Diagnostic::new(Code::UnknownName, span, found);
            self.tell(one.allowed("a port that the program reads or writes"));
        }
    }
}
