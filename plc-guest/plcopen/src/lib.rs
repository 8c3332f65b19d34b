//! Import of PLCopen XML projects (PLCopen TC6, XML formats for IEC 61131-3, version 2.01). That of
//! IEC 61131-10, whose root is a `<Project>`, is another one, and is not read.
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
mod positions;
mod pou;
mod type_spec;
mod value;
mod variables;

pub use error::{Defect, DefectKind, ImportError, Position};

use element::Element;
use positions::Positions;
use roxmltree::{Document, ParsingOptions};
use std::collections::{BTreeSet, HashMap};

/// The bytes that a project may have.
pub const MAXIMUM_BYTES: usize = 64 << 20;
/// The elements, texts and comments that a project may have.
pub const MAXIMUM_NODES: u32 = 4 << 20;
/// The refused parts that are told of each. Those beyond are counted.
pub const MAXIMUM_REFUSED: usize = 1000;

/// What a project became.
#[derive(Debug, Default, PartialEq, Eq)]
pub struct Import {
    /// The source files, in the order: types, units, global variables and configurations.
    pub files: Vec<SourceFile>,
    /// What was refused, in the order of the project; the first [`MAXIMUM_REFUSED`].
    pub refused: Vec<Defect>,
    /// How many parts more were refused.
    pub further: usize,
    /// What tools keep for themselves in the project (`addData`), by the names that they give it. Nothing of
    /// it is looked at but lists of global variables: what has other parts beside them is here too.
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
    let positions = Positions::new(text);
    let project = Element::new(document.root_element(), &positions);
    if project.tag() != "project" {
        let (found, at) = (project.tag().to_owned(), project.position());
        return Err(match &*found {
            "Project" => ImportError::OtherFormat { at },
            _ => ImportError::NoProject { found, at },
        });
    }
    let mut importer = Importer::default();
    if let Some(types) = project.child("types") {
        importer.data_types(types);
        importer.units(types);
    }
    if let Some(instances) = project.child("instances") {
        importer.configurations(instances);
    }
    for data in project.vendor_data() {
        importer.vendor_data(data);
    }
    Ok(importer.done)
}

#[derive(Default)]
struct Importer {
    done: Import,
    /// The names of all files in small letters, each with the number that another file of this name tries first.
    names: HashMap<String, usize>,
}

impl Importer {
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
            for part in pou::left_out(each) {
                self.refuse(|| part.not_supported());
            }
            self.or_refuse(pou::unit(each), |importer, (name, text)| importer.file(&name, text));
        }
    }

    fn configurations(&mut self, instances: Element<'_>) {
        let all = instances.child("configurations");
        for each in all.iter().flat_map(Element::children) {
            self.or_refuse(configuration::configuration(each), |importer, (name, text)| {
                importer.file(&name, text);
            });
        }
    }

    /// The format has no place for global variables outside of configurations, so tools that have them keep
    /// them as `<globalVars>` in data of their own.
    fn vendor_data(&mut self, data: Element<'_>) {
        let lists = || data.children().filter(|child| child.tag() == "globalVars");
        if lists().next().is_none() || !data.has_only("globalVars") {
            let name = data.attribute("name").map(str::to_owned);
            let name = name.unwrap_or_else(|| format!("<{}> without a name", data.tag()));
            self.done.ignored.insert(name);
        }
        for list in lists() {
            let text = list.name().and_then(|name| Ok((name, variables::section(list)?)));
            self.or_refuse(text, |importer, (name, text)| importer.file(name, text));
        }
    }

    /// Adds a file. Two names that differ in case only are one file where cases do not count, and the
    /// language does not tell them apart either: the second gets a number.
    fn file(&mut self, name: &str, text: String) {
        let mut file = name.to_owned();
        while self.names.contains_key(&file.to_ascii_lowercase()) {
            let number = self.names.entry(name.to_ascii_lowercase()).or_insert(2);
            file = format!("{name}_{number}");
            *number += 1;
        }
        self.names.insert(file.to_ascii_lowercase(), 2);
        self.done.files.push(SourceFile { name: format!("{file}.st"), text });
    }

    fn or_refuse<T>(&mut self, part: Result<T, Defect>, then: impl FnOnce(&mut Self, T)) {
        match part {
            Ok(part) => then(self, part),
            Err(defect) => self.refuse(|| defect),
        }
    }

    fn refuse(&mut self, defect: impl FnOnce() -> Defect) {
        if self.done.refused.len() < MAXIMUM_REFUSED {
            self.done.refused.push(defect());
        } else {
            self.done.further += 1;
        }
    }
}
