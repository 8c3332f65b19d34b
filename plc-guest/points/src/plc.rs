//! A PLC of a partition file, and the names of its values.

use std::path::{Path, PathBuf};
use std::rc::Rc;

use takt_plan::{Partition, PartitionFile};
use takt_program::Image;
use takt_protocol::{PartitionStatus, ProgramStatus};

use crate::{Connected, Error, Point, Search};

/// A PLC of a partition file.
#[derive(Clone)]
pub struct Plc {
    file: Rc<PartitionFile>,
    place: usize,
    control: Option<PathBuf>,
}

impl Plc {
    /// All partitions of a file that have programs. `control` is the socket, if it is not that of the file.
    ///
    /// # Errors
    /// If the file is wrong.
    pub fn all(path: &Path, control: Option<&Path>) -> Result<Vec<Self>, Error> {
        let file = takt_plan::load(path, None).map_err(|error| Error::Input(error.to_string()))?;
        let file = Rc::new(file);
        let places = (0..file.partitions().len())
            .filter(|place| !file.partitions()[*place].programs().is_empty());
        let plc =
            |place| Self { file: Rc::clone(&file), place, control: control.map(Path::to_owned) };
        Ok(places.map(plc).collect())
    }

    /// That of this name; without a name the only one that has programs.
    ///
    /// # Errors
    /// If the file is wrong, or it is not clear which is meant.
    pub fn one(path: &Path, name: Option<&str>, control: Option<&Path>) -> Result<Self, Error> {
        let mut with = Self::all(path, control)?;
        let found = match name {
            Some(name) => with.iter().position(|plc| plc.name() == name),
            None => (with.len() == 1).then_some(0),
        };
        found.map(|index| with.swap_remove(index)).ok_or_else(|| {
            let names: Vec<&str> = with.iter().map(Self::name).collect();
            Error::Input(match names[..] {
                [] => format!("no partition of {} has programs", path.display()),
                _ => format!("say which with --partition: {}", names.join(", ")),
            })
        })
    }

    /// The file.
    #[must_use]
    pub fn file(&self) -> &PartitionFile {
        &self.file
    }

    /// Its place among the partitions of the file.
    #[must_use]
    pub fn place(&self) -> usize {
        self.place
    }

    /// The partition.
    #[must_use]
    pub fn partition(&self) -> &Partition {
        &self.file.partitions()[self.place]
    }

    /// The name of the partition.
    #[must_use]
    pub fn name(&self) -> &str {
        self.partition().name()
    }

    /// The points that this name or pattern means.
    ///
    /// # Errors
    /// If there are too many.
    pub fn search(&self, name: &str) -> Result<Vec<Point>, Error> {
        let mut all = Vec::new();
        for (place, program) in (0..).zip(self.partition().programs()) {
            let Some(image) = program.image() else { continue };
            let found = Search::run(&program.name, place, &image, name);
            all.extend(found.map_err(|error| Error::Input(error.to_string()))?);
        }
        Ok(all)
    }

    /// The points that these names and patterns mean, in their order. Each must mean one at least.
    ///
    /// # Errors
    /// If one means none, or too many.
    pub fn points(&self, names: &[String]) -> Result<Vec<Point>, Error> {
        let mut all = Vec::new();
        for name in names {
            let found = self.search(name)?;
            if found.is_empty() {
                return Err(Self::unknown(name, std::slice::from_ref(self)));
            }
            all.extend(found);
        }
        Ok(all)
    }

    /// That a name means no value of these.
    #[must_use]
    pub fn unknown(name: &str, among: &[Self]) -> Error {
        let programs = among.iter().flat_map(|plc| plc.partition().programs());
        let programs: Vec<&str> = programs.map(|program| program.name.as_str()).collect();
        let rest = match programs[..] {
            [] => "no partition of the file has programs".to_owned(),
            _ => format!(
                "a name is PROGRAM.VARIABLE, the programs are {}; `takt plc points` lists all",
                programs.join(", ")
            ),
        };
        Error::Input(format!("no value is named `{name}`: {rest}"))
    }

    /// Whether the names of the file's images are those of what runs; `None` if the kernel has not told yet what that is.
    ///
    /// # Errors
    /// If they are not.
    pub fn compare(&self, running: &PartitionStatus, socket: &Path) -> Result<Option<()>, Error> {
        if running.programs.iter().any(|program| program.image.is_none()) {
            return Ok(None);
        }
        let ours = self.partition().programs();
        let same = |running: &ProgramStatus, (name, image): (&str, Image<'_>)| {
            let hash = takt_protocol::hex(&image.hash());
            running.name == name && running.image.as_ref() == Some(&hash)
        };
        let images = ours.iter().filter_map(|p| Some((p.name.as_str(), p.image()?)));
        let differs = running.programs.iter().zip(images).find(|(r, o)| !same(r, *o));
        if running.programs.len() != ours.len() || differs.is_some() {
            let name = differs.map_or("a program", |(running, _)| &running.name);
            return Err(Error::Input(format!(
                "the image of {name} in the file is not the one that runs behind {}, so its names would mean other \
                 places: use the partition file and the images that Takt was started with, or start the new ones",
                socket.display()
            )));
        }
        Ok(Some(()))
    }

    /// Connects to the Takt that runs it, and compares what runs with the images of the file.
    ///
    /// # Errors
    /// If no Takt answers, or other images run.
    pub fn connect(&self) -> Result<Connected<'_>, Error> {
        let socket = self.socket()?;
        let mut connected = self.reach()?;
        connected.compare(&socket)?;
        Ok(connected)
    }

    /// Connects for what does not depend on the images of the file.
    ///
    /// # Errors
    /// If no Takt answers.
    pub fn reach(&self) -> Result<Connected<'_>, Error> {
        Ok(Connected::new(self, takt_client::Connection::open(&self.socket()?)?))
    }

    fn socket(&self) -> Result<PathBuf, Error> {
        match &self.control {
            Some(socket) => Ok(socket.clone()),
            None => Ok(takt_client::given(&self.file)?),
        }
    }
}
