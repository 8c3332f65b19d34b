//! Licence expressions of SPDX, as far as Cargo.toml files have them.
//!
//! `OR` binds weaker than `AND`, as the specification has it (SPDX 2.3, annex D). The slash is an
//! old way to write `OR`. An exception (`WITH`) makes a licence another one, which has to be allowed
//! by its whole name.

/// Whether what the expression demands can be met with these licences; `None` if it is none.
pub fn is_met(expression: &str, allowed: &[String]) -> Option<bool> {
    let spaced = expression.replace('(', " ( ").replace(')', " ) ").replace('/', " OR ");
    let mut parser = Parser { words: spaced.split_whitespace().peekable(), allowed };
    let met = parser.any()?;
    parser.words.next().is_none().then_some(met)
}

struct Parser<'a, W: Iterator<Item = &'a str>> {
    words: std::iter::Peekable<W>,
    allowed: &'a [String],
}

impl<'a, W: Iterator<Item = &'a str>> Parser<'a, W> {
    fn any(&mut self) -> Option<bool> {
        let mut met = self.all()?;
        while self.words.next_if_eq(&"OR").is_some() {
            met |= self.all()?;
        }
        Some(met)
    }

    fn all(&mut self) -> Option<bool> {
        let mut met = self.one()?;
        while self.words.next_if_eq(&"AND").is_some() {
            met &= self.one()?;
        }
        Some(met)
    }

    fn one(&mut self) -> Option<bool> {
        if self.words.next_if_eq(&"(").is_some() {
            let met = self.any()?;
            return self.words.next_if_eq(&")").map(|_| met);
        }
        let is_name = |word: &&str| !["AND", "OR", "WITH", "(", ")"].contains(word);
        let mut name = self.words.next_if(is_name)?.to_owned();
        if self.words.next_if_eq(&"WITH").is_some() {
            name = format!("{name} WITH {}", self.words.next_if(is_name)?);
        }
        Some(self.allowed.contains(&name))
    }
}

#[test]
fn an_expression_is_met_or_not_or_none() {
    let allowed = ["A".to_owned(), "B".to_owned(), "D WITH x".to_owned()];
    for (expression, expected) in [
        ("A", Some(true)),
        ("C", Some(false)),
        ("C OR A", Some(true)),
        ("C/A", Some(true)),
        ("A AND C", Some(false)),
        ("A AND B", Some(true)),
        ("C AND A OR B", Some(true)),
        ("C AND (A OR B)", Some(false)),
        ("(C OR A) AND B", Some(true)),
        ("A WITH x OR C", Some(false)),
        ("D WITH x", Some(true)),
        ("D", Some(false)),
        ("", None),
        ("A OR", None),
        ("A B", None),
        ("(A", None),
        ("A)", None),
        ("AND A", None),
    ] {
        assert_eq!(is_met(expression, &allowed), expected, "{expression}");
    }
}
