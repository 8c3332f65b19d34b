//! What the author called the records of the image that break a rule.

use takt_program::ImageError;

use super::LinkError;
use super::declared::Declared;

/// The names of what is declared, in the order of the image's tables.
#[derive(Default)]
pub struct Names {
    pub tasks: Vec<Named>,
    pub objects: Vec<Named>,
    pub ports: Vec<Named>,
    pub points: Vec<Named>,
}

/// A name, and file and line of the declaration.
pub struct Named {
    pub name: String,
    place: Option<String>,
}

impl From<&Declared> for Named {
    fn from(declared: &Declared) -> Self {
        Self { name: declared.name.clone(), place: declared.place.clone() }
    }
}

impl Names {
    /// The same error about what the author declared, if it is about that. A number or an offset in the image tells an author
    /// nothing.
    pub fn error(&self, error: ImageError) -> LinkError {
        let (what, names) = match error.record {
            "task" => ("task", &self.tasks),
            "object" => ("object", &self.objects),
            "port" => ("port", &self.ports),
            "variable" => ("point", &self.points),
            _ => return error.into(),
        };
        match names.get(error.index as usize) {
            None => error.into(),
            Some(Named { name, place }) => {
                let what = format!("{what} `{name}`");
                LinkError::Rule { what, field: error.field, defect: error.defect }
                    .at(place.as_ref())
            }
        }
    }
}
