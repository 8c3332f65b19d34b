//! What the author called the records of the image that break a rule.

use takt_program::ImageError;

use super::LinkError;

/// The names of what is declared, in the order of the image's tables.
#[derive(Default)]
pub struct Names {
    pub tasks: Vec<String>,
    pub objects: Vec<String>,
    pub ports: Vec<String>,
    pub points: Vec<String>,
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
            Some(name) => LinkError::Rule {
                what: format!("{what} `{name}`"),
                field: error.field,
                defect: error.defect,
            },
        }
    }
}
