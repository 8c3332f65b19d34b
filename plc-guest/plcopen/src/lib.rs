//! Import of PLCopen XML projects (PLCopen TC6, XML formats for IEC 61131-3, version 2.01; IEC 61131-10).
//!
//! Most tools for IEC 61131-3 export this format. What such a project has in Structured Text becomes
//! source files: data types, program organisation units, global variables and configurations. The
//! text of bodies is taken as it is; the declarations, which the format has as elements, are written anew.
//!
//! What is not Structured Text is refused by name: bodies in FBD, LD, SFC and IL, actions, transitions,
//! and what vendors add. The rest of the project is imported all the same, since a body that was
//! refused can be written by hand, and a project is not lost for one diagram.
//!
//! A project is a stranger's file. It cannot name a file outside of the folder that the caller writes to,
//! since each name has to be an identifier; it has bounds on its size and depth; it has no DTD, and so no
//! entities.

#![forbid(unsafe_code)]

mod body;
mod configuration;
mod element;
mod error;
mod pou;
mod type_spec;
mod value;
mod variables;

pub use error::{Defect, DefectKind, ImportError, Position};

use element::Element;
use roxmltree::{Document, ParsingOptions};
use std::collections::BTreeSet;

/// The bytes that a project may have.
pub const MAXIMUM_BYTES: usize = 64 << 20;
/// The elements, texts and comments that a project may have.
pub const MAXIMUM_NODES: u32 = 4 << 20;

/// What a project became.
#[derive(Debug, Default, PartialEq, Eq)]
pub struct Import {
    /// The source files, in the order: types, units, global variables and configurations.
    pub files: Vec<SourceFile>,
    /// What was refused, in the order of the project.
    pub refused: Vec<Defect>,
    /// What tools keep for themselves in the project (`addData`), by the names that they give it. Nothing of
    /// it is looked at but lists of global variables.
    pub ignored: BTreeSet<String>,
}

/// A file of Structured Text.
#[derive(Debug, PartialEq, Eq)]
pub struct SourceFile {
    /// Its name: an identifier and `.st`.
    pub name: String,
    /// Its text.
    pub text: String,
}

/// Imports the text of a project.
///
/// # Errors
///
/// If the text is no XML, too large, or no PLCopen project. What is wrong with parts of a project is in
/// [`Import::refused`].
pub fn import(text: &str) -> Result<Import, ImportError> {
    if text.len() > MAXIMUM_BYTES {
        return Err(ImportError::TooLarge { bytes: text.len(), maximum: MAXIMUM_BYTES });
    }
    let options = ParsingOptions {
        allow_dtd: false,
        nodes_limit: MAXIMUM_NODES,
        ..ParsingOptions::default()
    };
    let document = Document::parse_with_options(text, options)?;
    let project = Element::new(document.root_element());
    if project.tag() != "project" {
        let found = project.tag().to_owned();
        return Err(ImportError::NoProject { found, at: project.position() });
    }
    let mut import = Import::default();
    if let Some(types) = project.child("types") {
        import.data_types(types);
        import.units(types);
    }
    if let Some(instances) = project.child("instances") {
        import.configurations(instances);
    }
    for data in project.vendor_data() {
        import.vendor_data(data);
    }
    Ok(import)
}

impl Import {
    fn data_types(&mut self, types: Element<'_>) {
        let mut text = String::new();
        for each in types.child("dataTypes").iter().flat_map(Element::children) {
            self.or_refuse(type_spec::declaration(each), |_, declared| text.push_str(&declared));
        }
        if !text.is_empty() {
            self.file("types", format!("TYPE\n{text}END_TYPE\n"));
        }
    }

    fn units(&mut self, types: Element<'_>) {
        for each in types.child("pous").iter().flat_map(Element::children) {
            self.refused.extend(pou::left_out(each));
            self.or_refuse(pou::unit(each), |import, (name, text)| import.file(&name, text));
        }
    }

    fn configurations(&mut self, instances: Element<'_>) {
        let all = instances.child("configurations");
        for each in all.iter().flat_map(Element::children) {
            self.or_refuse(configuration::configuration(each), |import, (name, text)| {
                import.file(&name, text);
            });
        }
    }

    /// The format has no place for global variables outside of configurations, so tools that have them keep
    /// them as `<globalVars>` in data of their own.
    fn vendor_data(&mut self, data: Element<'_>) {
        let mut lists = data.children().filter(|child| child.tag() == "globalVars").peekable();
        if lists.peek().is_none() {
            self.ignored.extend(data.attribute("name").map(str::to_owned));
        }
        for list in lists {
            let text = list.name().and_then(|name| Ok((name, variables::section(list)?)));
            self.or_refuse(text, |import, (name, text)| import.file(name, text));
        }
    }

    /// Adds a file. Two names that differ in case only are one file where cases do not count, and the
    /// language does not tell them apart either: the second gets a number.
    fn file(&mut self, name: &str, text: String) {
        let taken = |import: &Self, name: &str| {
            import.files.iter().any(|file| file.name.eq_ignore_ascii_case(name))
        };
        let mut file = format!("{name}.st");
        let mut number = 2;
        while taken(self, &file) {
            file = format!("{name}_{number}.st");
            number += 1;
        }
        self.files.push(SourceFile { name: file, text });
    }

    fn or_refuse<T>(&mut self, part: Result<T, Defect>, then: impl FnOnce(&mut Self, T)) {
        match part {
            Ok(part) => then(self, part),
            Err(defect) => self.refused.push(defect),
        }
    }
}
