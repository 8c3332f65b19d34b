//! Elements of a project, with the checks that each use of them needs.
//!
//! Names are compared without their namespace: exporters differ in the version that it names, and not in the
//! elements that are read here.

use crate::error::{Defect, DefectKind, Position};
use crate::positions::Positions;
use roxmltree::Node;

/// How long a name may be.
const NAME_LENGTH: usize = 128;
/// The elements of XHTML that begin and end a line (XHTML 1.0, block-level elements, with the parts of lists and tables).
const BLOCKS: [&str; 30] = [
    "address",
    "blockquote",
    "body",
    "center",
    "dd",
    "dir",
    "div",
    "dl",
    "dt",
    "fieldset",
    "form",
    "h1",
    "h2",
    "h3",
    "h4",
    "h5",
    "h6",
    "hr",
    "li",
    "menu",
    "ol",
    "p",
    "pre",
    "table",
    "tbody",
    "tfoot",
    "thead",
    "tr",
    "ul",
    "caption",
];

/// An element. `addData`, where tools keep what is their own, and comments do not show.
#[derive(Clone, Copy, Debug)]
pub struct Element<'a> {
    node: Node<'a, 'a>,
    positions: &'a Positions<'a>,
}

impl<'a> Element<'a> {
    pub fn new(node: Node<'a, 'a>, positions: &'a Positions<'a>) -> Self {
        Self { node, positions }
    }

    pub fn tag(&self) -> &'a str {
        self.node.tag_name().name()
    }

    pub fn position(&self) -> Position {
        self.positions.of(self.node.range().start)
    }

    /// The elements in it, but for documentation and what tools keep for themselves.
    pub fn children(&self) -> impl Iterator<Item = Element<'a>> + use<'a> {
        self.elements().filter(|child| !matches!(child.tag(), "addData" | "documentation"))
    }

    fn elements(&self) -> impl Iterator<Item = Element<'a>> + use<'a> {
        let positions = self.positions;
        let all = self.node.children().filter(Node::is_element);
        all.map(move |node| Self { node, positions })
    }

    /// Whether nothing is in it but elements of this name, and what [`vendor_data`](Self::vendor_data) finds by itself.
    pub fn has_only(&self, tag: &str) -> bool {
        self.node.children().all(|node| match node.tag_name().name() {
            "" => !node.is_text() || node.text().is_none_or(|text| text.trim().is_empty()),
            name => name == tag || name == "addData",
        })
    }

    pub fn child(&self, tag: &str) -> Option<Element<'a>> {
        self.children().find(|child| child.tag() == tag)
    }

    /// The only element in it, whatever it is; `wanted` is for the message.
    pub fn inner(&self, wanted: &'static str) -> Result<Element<'a>, Defect> {
        self.children().next().ok_or_else(|| self.lacks(wanted))
    }

    /// What tools keep for themselves anywhere in it.
    pub fn vendor_data(&self) -> impl Iterator<Item = Element<'a>> + use<'a> {
        let positions = self.positions;
        let all = self.node.descendants().filter(|node| node.tag_name().name() == "addData");
        all.flat_map(move |node| Self { node, positions }.elements())
    }

    pub fn required(&self, tag: &'static str) -> Result<Element<'a>, Defect> {
        self.child(tag).ok_or_else(|| self.lacks(tag))
    }

    pub fn attribute(&self, name: &str) -> Option<&'a str> {
        self.node.attribute(name)
    }

    pub fn required_attribute(&self, attribute: &'static str) -> Result<&'a str, Defect> {
        self.attribute(attribute).ok_or_else(|| {
            self.defect(DefectKind::MissingAttribute { element: self.tag().to_owned(), attribute })
        })
    }

    /// The attribute `name`, if it is a name of the language.
    pub fn name(&self) -> Result<&'a str, Defect> {
        self.name_in("name")
    }

    /// An attribute that has to be a name of the language.
    pub fn name_in(&self, attribute: &'static str) -> Result<&'a str, Defect> {
        let name = self.required_attribute(attribute)?;
        if is_name(name) {
            Ok(name)
        } else {
            Err(self.defect(DefectKind::Name { name: name.to_owned() }))
        }
    }

    /// An attribute that has to be a whole number, perhaps with a sign.
    pub fn integer(&self, attribute: &'static str) -> Result<&'a str, Defect> {
        let value = self.required_attribute(attribute)?.trim();
        let digits = value.strip_prefix(['-', '+']).unwrap_or(value);
        if !digits.is_empty() && digits.len() <= 20 && digits.bytes().all(|b| b.is_ascii_digit()) {
            Ok(value)
        } else {
            Err(self.value(value, "whole number"))
        }
    }

    /// Whether an attribute is `true`.
    pub fn flag(&self, attribute: &str) -> bool {
        matches!(self.attribute(attribute), Some("true" | "1"))
    }

    /// The text of its documentation, if it has any.
    pub fn documentation(&self) -> String {
        let all = self.elements().filter(|child| child.tag() == "documentation");
        all.map(|child| child.text()).collect()
    }

    /// All text in it, in order; line breaks of XHTML are line breaks, and so are both ends of its blocks: what follows
    /// must not become a part of a comment before it.
    pub fn text(&self) -> String {
        let mut text = String::new();
        let (mut broken, mut ends) = (false, Vec::new());
        for node in self.node.descendants() {
            let range = node.range();
            while ends.pop_if(|end| *end <= range.start).is_some() {
                broken = true;
            }
            match node.tag_name().name() {
                "br" => broken = true,
                name if BLOCKS.contains(&name) => {
                    broken = true;
                    ends.push(range.end);
                }
                _ => {}
            }
            if node.is_text() {
                let piece = node.text().unwrap_or_default();
                let apart = text.is_empty() || text.ends_with('\n') || piece.starts_with('\n');
                if broken && !apart {
                    text.push('\n');
                }
                text.push_str(piece);
                broken = false;
            }
        }
        text
    }

    pub fn defect(&self, kind: DefectKind) -> Defect {
        Defect { at: self.position(), part: self.part(), kind }
    }

    pub fn not_supported(&self) -> Defect {
        self.defect(DefectKind::NotSupported { element: self.tag().to_owned() })
    }

    pub fn value(&self, value: &str, expected: &'static str) -> Defect {
        self.defect(DefectKind::Value { value: value.to_owned(), expected })
    }

    fn lacks(&self, child: &'static str) -> Defect {
        self.defect(DefectKind::MissingChild { element: self.tag().to_owned(), child })
    }

    /// The part of the project that it is in, as an engineer calls it.
    fn part(&self) -> String {
        for node in self.node.ancestors() {
            let name = node.attribute("name").unwrap_or("without a name");
            // It is in each defect of the part.
            let name: String = name.chars().take(NAME_LENGTH).collect();
            let kind = match node.tag_name().name() {
                "pou" => match node.attribute("pouType") {
                    Some("functionBlock") => "function block",
                    Some("function") => "function",
                    _ => "program",
                },
                "dataType" => "type",
                "configuration" => "configuration",
                _ => continue,
            };
            // It may be anything, and is shown on a terminal.
            return format!("{kind} {}", name.escape_debug());
        }
        "project".to_owned()
    }
}

/// Whether a text can be a name in Structured Text.
pub fn is_name(text: &str) -> bool {
    let mut bytes = text.bytes();
    text.len() <= NAME_LENGTH
        && bytes.next().is_some_and(|b| b.is_ascii_alphabetic() || b == b'_')
        && bytes.all(|b| b.is_ascii_alphanumeric() || b == b'_')
}
