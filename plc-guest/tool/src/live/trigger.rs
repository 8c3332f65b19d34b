//! What a recording waits for: `NAME OPERATOR VALUE`, such as `tank.level > 1.1`.

use std::cmp::Ordering;

use crate::value::Value;

/// A comparison.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Operator {
    Less,
    LessOrEqual,
    Equal,
    Unequal,
    GreaterOrEqual,
    Greater,
}

/// Longer ones first: `>` begins `>=`.
const OPERATORS: [(&str, Operator); 6] = [
    ("<=", Operator::LessOrEqual),
    (">=", Operator::GreaterOrEqual),
    ("<>", Operator::Unequal),
    ("<", Operator::Less),
    (">", Operator::Greater),
    ("=", Operator::Equal),
];

impl Operator {
    /// Whether it holds. A REAL that is no number is unequal to all, and neither less nor greater.
    pub fn holds(self, left: Value, right: Value) -> bool {
        let order = left.partial_cmp(&right);
        match self {
            Operator::Less => order == Some(Ordering::Less),
            Operator::LessOrEqual => matches!(order, Some(Ordering::Less | Ordering::Equal)),
            Operator::Equal => order == Some(Ordering::Equal),
            Operator::Unequal => order != Some(Ordering::Equal),
            Operator::GreaterOrEqual => matches!(order, Some(Ordering::Greater | Ordering::Equal)),
            Operator::Greater => order == Some(Ordering::Greater),
        }
    }
}

/// A trigger as it is written.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Written<'t> {
    pub name: &'t str,
    pub operator: Operator,
    pub value: &'t str,
    /// Where the name and the value begin, counted in characters from 0.
    pub name_at: usize,
    pub value_at: usize,
}

/// What is wrong with a trigger, and where.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Wrong {
    pub at: usize,
    pub message: String,
}

impl Wrong {
    /// The trigger with a mark below the place.
    pub fn shown(&self, text: &str) -> String {
        let column = self.at + 1;
        format!("{}, column {column} of the trigger:\n  {text}\n  {:>column$}", self.message, '^')
    }
}

impl<'t> Written<'t> {
    /// Reads it.
    pub fn parse(text: &'t str) -> Result<Self, Wrong> {
        let wrong = |byte: usize, message: String| {
            let at = text.get(..byte).map_or(0, |before| before.chars().count());
            Wrong { at, message }
        };
        let Some(operator_at) = text.find(['<', '>', '=']) else {
            let message = "found no comparison; allowed: NAME, one of < <= = <> >= >, VALUE";
            return Err(wrong(text.trim_end().len(), message.to_owned()));
        };
        let (name, rest) = text.split_at(operator_at);
        let name_at = name.len() - name.trim_start().len();
        let name = name.trim();
        if name.is_empty() {
            return Err(wrong(operator_at, "found no name before the comparison".to_owned()));
        }
        if let Some(space) = name.find(char::is_whitespace) {
            let message = "found a space in the name; a name is PROGRAM.VARIABLE".to_owned();
            return Err(wrong(name_at + space, message));
        }
        let found = OPERATORS.iter().find(|(sign, _)| rest.starts_with(sign));
        let Some((sign, operator)) = found else {
            return Err(wrong(operator_at, "found no comparison".to_owned()));
        };
        let value = rest.get(sign.len()..).unwrap_or_default();
        let value_at = text.len() - value.trim_start().len();
        let value = value.trim();
        if value.is_empty() {
            let message = format!("found no value after `{sign}`");
            return Err(wrong(text.trim_end().len(), message));
        }
        if value.starts_with(['<', '>', '=']) {
            let message = format!("found `{sign}{value}`; allowed: < <= = <> >= >");
            return Err(wrong(operator_at, message));
        }
        let at = |byte: usize| text.get(..byte).map_or(0, |before| before.chars().count());
        let (name_at, value_at) = (at(name_at), at(value_at));
        Ok(Self { name, operator: *operator, value, name_at, value_at })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_trigger_is_a_name_a_comparison_and_a_value() {
        for (text, name, operator, value) in [
            ("tank.level > 1.1", "tank.level", Operator::Greater, "1.1"),
            ("tank.level>=-1", "tank.level", Operator::GreaterOrEqual, "-1"),
            (" tank.row[2].on = TRUE ", "tank.row[2].on", Operator::Equal, "TRUE"),
            ("a.b <> T#1s", "a.b", Operator::Unequal, "T#1s"),
            ("a.b<=0", "a.b", Operator::LessOrEqual, "0"),
            ("a.b < filling", "a.b", Operator::Less, "filling"),
        ] {
            let found = Written::parse(text).unwrap();
            assert_eq!((found.name, found.operator, found.value), (name, operator, value));
            let from = |at: usize| text.chars().skip(at).collect::<String>();
            assert!(from(found.name_at).starts_with(name), "{text}");
            assert!(from(found.value_at).starts_with(value), "{text}");
        }
    }

    #[test]
    fn what_is_wrong_is_shown_at_its_column() {
        for (text, at, message) in [
            ("", 0, "no comparison"),
            ("tank.level", 10, "no comparison"),
            ("tank.level ", 10, "no comparison"),
            ("> 1", 0, "no name"),
            ("tank level > 1", 4, "a space in the name"),
            ("tank.level >", 12, "no value after `>`"),
            ("tänk.level >> 1", 11, "found `>> 1`"),
            ("tänk.level => 1", 11, "found `=> 1`"),
        ] {
            let wrong = Written::parse(text).unwrap_err();
            assert!(wrong.at == at && wrong.message.contains(message), "{text:?}: {wrong:?}");
        }
        let wrong = Written::parse("a.b >").unwrap_err();
        assert!(wrong.shown("a.b >").ends_with("\n  a.b >\n       ^"), "{}", wrong.shown("a.b >"));
    }

    #[test]
    fn comparisons_hold_as_numbers_do() {
        let (less, more, none) = (Value::Float(-1.5), Value::Float(2.0), Value::Float(f64::NAN));
        let holding = |left, right| {
            OPERATORS.iter().filter(move |(_, o)| o.holds(left, right)).map(|(sign, _)| *sign)
        };
        assert!(holding(less, more).eq(["<=", "<>", "<"]));
        assert!(holding(more, less).eq([">=", "<>", ">"]));
        assert!(holding(more, more).eq(["<=", ">=", "="]));
        assert!(holding(none, none).eq(["<>"]));
        assert!(Operator::Less.holds(Value::Signed(-2), Value::Signed(1)));
    }
}
