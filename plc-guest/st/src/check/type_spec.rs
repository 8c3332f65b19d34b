//! Types as they are written.

use super::body::Body;
use super::types::{Resolved, STATE_BYTES, STRING_LENGTH, is_bit_string, is_integer};
use crate::diagnostic::{Code, Diagnostic};
use crate::hir::{Constant, Elementary, Type, TypeId};
use crate::limits;
use crate::source::Span;
use crate::syntax::ast::{self, ArrayRange, Name, TypeKind, TypeSpec};

impl<'a> Body<'_, 'a> {
    /// A type as it is written; `name` if that is the whole declaration of a type.
    pub(super) fn type_spec(
        &mut self,
        spec: &'a TypeSpec,
        name: Option<&Name>,
    ) -> Option<Resolved> {
        let shown = name.map_or_else(|| self.checker.sources.text(spec.span), |name| &*name.text);
        match &spec.kind {
            TypeKind::Named(name) => self.checker.named_type(name, false),
            TypeKind::Text { wide, length } => {
                let length = match length {
                    Some(length) => self.string_length(length)?,
                    None => STRING_LENGTH,
                };
                let types = &mut self.checker.program.types;
                Some(if *wide { types.wstring(length) } else { types.string(length) }.into())
            }
            TypeKind::Array { ranges, element } => self.array_type(ranges, element, spec.span),
            TypeKind::Reference(target) => {
                let target = match &target.kind {
                    TypeKind::Named(name) => self.checker.named_type(name, true)?,
                    _ => self.type_spec(target, None)?,
                };
                if matches!(self.checker.program.types.get(target.ty), Type::OpenArray { .. }) {
                    // It would have to keep the bounds, too.
                    let found = "a reference to an ARRAY[*]";
                    let one = Diagnostic::new(Code::InvalidDeclaration, spec.span, found);
                    self.checker.tell(one.allowed("bounds, or ARRAY[*] for a parameter"));
                    return None;
                }
                let ty = self.checker.program.types.reference(target.ty);
                self.not_too_deep(ty, spec.span)
            }
            TypeKind::Subrange { base, low, high } => {
                let shown = shown.to_owned();
                self.subrange(base, low, high, &shown)
            }
            TypeKind::Enumeration { base, values } => {
                let shown = shown.to_owned();
                let twice = name.is_some_and(|name| self.checker.is_declared_twice(name));
                self.enumeration(base.as_ref(), values, &shown, twice)
            }
            TypeKind::Structure { .. } => {
                self.checker.tell(
                    Diagnostic::new(
                        Code::InvalidDeclaration,
                        spec.span,
                        "a structure without a name",
                    )
                    .hint("declare it in a TYPE block and use its name here"),
                );
                None
            }
            TypeKind::Error => None,
        }
    }

    fn not_too_deep(&mut self, ty: TypeId, span: Span) -> Option<Resolved> {
        self.checker.not_too_deep(self.checker.program.types.depth(ty), span)?;
        Some(ty.into())
    }

    fn string_length(&mut self, length: &'a ast::Expression) -> Option<u16> {
        let value = self.constant_integer(length)?;
        match u16::try_from(value) {
            Ok(value) if value > 0 => Some(value),
            _ => {
                self.checker.tell(
                    Diagnostic::new(
                        Code::InvalidRange,
                        length.span,
                        format!("a string of {value} characters"),
                    )
                    .allowed("1 to 65535 characters"),
                );
                None
            }
        }
    }

    fn array_type(
        &mut self,
        ranges: &'a [ArrayRange],
        element: &'a TypeSpec,
        span: Span,
    ) -> Option<Resolved> {
        // Each is an array, and the elements are a level too.
        if ranges.len() >= limits::DEPTH as usize {
            let found = format!("an array of {} dimensions", ranges.len());
            let allowed = format!("at most {} dimensions", limits::DEPTH - 1);
            self.checker.tell(Diagnostic::new(Code::TooDeep, span, found).allowed(allowed));
            return None;
        }
        let resolved = self.type_spec(element, None)?;
        if matches!(self.checker.program.types.get(resolved.ty), Type::OpenArray { .. }) {
            self.checker.error(Code::InvalidDeclaration, element.span, "an array of ARRAY[*]");
            return None;
        }
        let open = ranges.iter().filter(|range| matches!(range, ArrayRange::Open(_))).count();
        if open == ranges.len() {
            let ty = self.checker.program.types.open_array(resolved.ty, open as u8);
            return self.not_too_deep(ty, span);
        }
        if open > 0 {
            self.checker.tell(
                Diagnostic::new(Code::InvalidRange, span, "an array with some bounds open")
                    .allowed("bounds for all dimensions, or `*` for all"),
            );
            return None;
        }
        let mut bounds = Vec::new();
        for range in ranges {
            let ArrayRange::Fixed(range) = range else { return None };
            let (low, high) = (self.constant_integer(&range.0), self.constant_integer(&range.1));
            let (low, high) = (low?, high?);
            let span = range.0.span.to(range.1.span);
            let (Ok(low), Ok(high)) = (i64::try_from(low), i64::try_from(high)) else {
                self.checker.error(Code::InvalidRange, span, "bounds of more than 64 bits");
                return None;
            };
            if low > high {
                self.checker.tell(
                    Diagnostic::new(
                        Code::InvalidRange,
                        span,
                        format!("an array from {low} to {high} has no element"),
                    )
                    .allowed("the lower bound first, at most as large as the upper"),
                );
                return None;
            }
            bounds.push((low, high));
        }
        let mut ty = resolved.ty;
        let mut initial = resolved.initial;
        for (low, high) in bounds.into_iter().rev() {
            let count = i128::from(high) - i128::from(low) + 1;
            let size = i128::from(self.checker.program.types.size(ty)) * count;
            if size > i128::from(STATE_BYTES) {
                self.checker.too_large(span);
                return None;
            }
            ty = self.checker.program.types.array(ty, low, high);
            self.not_too_deep(ty, span)?;
            if initial != Constant::Default {
                initial = Constant::Fill(Box::new(initial));
            }
        }
        Some(Resolved { ty, initial })
    }

    fn integer_base(&mut self, base: &Name, what: &str, bits: bool) -> Option<Elementary> {
        let ty = self.checker.named_type(base, false)?.ty;
        let found = match self.checker.program.types.get(ty) {
            Type::Elementary(found) => Some(*found),
            _ => None,
        };
        let fits = |found: &Elementary| {
            is_integer(*found) || bits && is_bit_string(*found) && *found != Elementary::Bool
        };
        if let Some(found) = found.filter(fits) {
            return Some(found);
        }
        let found = format!("{what} of {}", self.checker.type_name(ty));
        let one = Diagnostic::new(Code::TypeMismatch, base.span, found);
        self.checker.tell(one.allowed("an integer type"));
        None
    }

    fn subrange(
        &mut self,
        base: &'a Name,
        low: &'a ast::Expression,
        high: &'a ast::Expression,
        shown: &str,
    ) -> Option<Resolved> {
        let elementary = self.integer_base(base, "a subrange", false);
        let (lower, upper) = (self.constant_integer(low), self.constant_integer(high));
        let (elementary, lower, upper) = (elementary?, lower?, upper?);
        let (least, most) = elementary.range()?;
        if lower > upper || lower < least || upper > most {
            let found = format!("a subrange from {lower} to {upper} of {}", elementary.name());
            self.checker.tell(
                Diagnostic::new(Code::InvalidRange, low.span.to(high.span), found)
                    .allowed(format!("within {least}..{most}, the lower bound first")),
            );
            return None;
        }
        Some(self.checker.program.types.subrange(shown, elementary, lower, upper).into())
    }

    fn enumeration(
        &mut self,
        base: Option<&'a Name>,
        values: &'a [ast::EnumerationValue],
        shown: &str,
        twice: bool,
    ) -> Option<Resolved> {
        let base = match base {
            Some(base) => self.integer_base(base, "an enumeration", true)?,
            None => Elementary::Int,
        };
        let (least, most) = base.range()?;
        let mut list: Vec<(String, i128)> = Vec::new();
        let mut seen = std::collections::HashMap::new();
        let mut next = 0;
        for value in values {
            if let Some(expression) = &value.value
                && let Some(written) = self.constant_integer(expression)
            {
                next = written;
            }
            if next < least || next > most {
                let found = format!("`{}` has the value {next}", value.name.text);
                let allowed = format!("{least}..{most} ({})", base.name());
                self.checker.tell(
                    Diagnostic::new(Code::OutOfRange, value.name.span, found).allowed(allowed),
                );
                next = least;
            }
            if let Some(other) = seen.insert(&*value.name.key, value.name.span) {
                self.checker.duplicate(&value.name, other);
                continue;
            }
            list.push((value.name.text.to_string(), next));
            next += 1;
        }
        let ty = self.checker.program.types.enumeration(shown, base, list.clone());
        // Values of a second type of the same name would be ambiguous with those of the first.
        for (name, value) in list.into_iter().filter(|_| !twice) {
            let key = name.to_ascii_uppercase();
            self.checker.enumeration_values.entry(key).or_default().push((ty, value));
        }
        Some(ty.into())
    }
}
