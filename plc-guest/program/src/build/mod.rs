//! Makes images.
//!
//! A [`Builder`] is filled in any order and gives the bytes of an image. It checks nothing by
//! itself: what it has written is read with [`Image::verify`], so that there is one set of rules.
//!
//! ```
//! use takt_program::build::{Builder, Task, Type, Variable};
//! use takt_program::{Area, CodeOffset, Elementary, Flags, Image, Nanoseconds};
//!
//! let mut image = Builder::new("tank");
//! image.code = vec![0xc3]; // ret
//! image.state_bytes = 4;
//! let real = image.elementary(Elementary::Real);
//! image.variable(Variable::new("Main.level", real, Area::State, 0).with(Flags::FORCEABLE));
//! image.task(Task::cyclic("main", Nanoseconds(10_000_000), CodeOffset(0)));
//! let bytes = image.build()?;
//! assert_eq!(Image::verify(&bytes)?.variable("main.LEVEL").unwrap().bytes, 4);
//! # Ok::<(), takt_program::ImageError>(())
//! ```

mod describe;
mod records;
mod write;

use alloc::string::String;
use alloc::vec::Vec;

pub use describe::{
    Event, Field, Kind, Line, Object, Place, Port, Task, Trap, Type, Variable, When,
};

use crate::image::Version;
use crate::units::{CodeOffset, TaskId, TypeId};
use crate::{Elementary, Image, ImageError};

/// An image in the making.
#[derive(Clone, Debug, Default)]
pub struct Builder {
    /// The program's name.
    pub name: String,
    /// The author's version.
    pub version: Version,
    /// The category, of the user's choice.
    pub category: u32,
    /// The function that runs once for each start.
    pub init: Option<CodeOffset>,
    /// The code, linked for [`address::CODE`](crate::address::CODE).
    pub code: Vec<u8>,
    /// The constants, linked for [`address::constants`](crate::address::constants).
    pub constants: Vec<u8>,
    /// The first bytes of the state at a cold start, linked for [`address::STATE`](crate::address::STATE).
    pub state: Vec<u8>,
    /// Size of the state in memory; what `state` does not have is zero. If it is less than `state`
    /// has, the state is as large as that.
    pub state_bytes: u32,
    /// Size of the input image `%I`, in bytes.
    pub input_bytes: u32,
    /// Size of the output image `%Q`, in bytes.
    pub output_bytes: u32,
    /// Size of the markers `%M`, in bytes.
    pub marker_bytes: u32,
    types: Vec<Type>,
    variables: Vec<Variable>,
    tasks: Vec<Task>,
    objects: Vec<Object>,
    ports: Vec<Port>,
    traps: Vec<Trap>,
    lines: Vec<Line>,
}

impl Builder {
    /// An empty program of this name.
    #[must_use]
    pub fn new(name: &str) -> Self {
        Self { name: name.into(), ..Self::default() }
    }

    /// Adds a type and gives its number. A type that is there already is not added again.
    pub fn ty(&mut self, ty: Type) -> TypeId {
        let index = self.types.iter().position(|there| *there == ty).unwrap_or_else(|| {
            self.types.push(ty);
            self.types.len() - 1
        });
        // More than a u32 are refused as more than the limit when the image is read.
        TypeId(u32::try_from(index).unwrap_or(u32::MAX))
    }

    /// The number that the next new type gets. A reference to its own number is one whose target is not told.
    #[must_use]
    pub fn next_type(&self) -> TypeId {
        TypeId(u32::try_from(self.types.len()).unwrap_or(u32::MAX))
    }

    /// The number of an elementary type.
    pub fn elementary(&mut self, elementary: Elementary) -> TypeId {
        self.ty(Type::elementary(elementary))
    }

    /// A type that was added.
    #[must_use]
    pub fn type_of(&self, id: TypeId) -> Option<&Type> {
        self.types.get(id.0 as usize)
    }

    /// Adds a variable. The table is sorted by name when it is built.
    pub fn variable(&mut self, variable: Variable) {
        self.variables.push(variable);
    }

    /// Adds a task and gives its number.
    pub fn task(&mut self, task: Task) -> TaskId {
        self.tasks.push(task);
        TaskId(u16::try_from(self.tasks.len() - 1).unwrap_or(u16::MAX))
    }

    /// Adds a kernel object and gives its number in calls.
    pub fn object(&mut self, object: Object) -> u32 {
        self.objects.push(object);
        (self.objects.len() - 1) as u32
    }

    /// Adds a channel port and gives its number in calls.
    pub fn port(&mut self, port: Port) -> u32 {
        self.ports.push(port);
        (self.ports.len() - 1) as u32
    }

    /// Adds an entry to the trap map. The map is sorted when it is built.
    pub fn trap(&mut self, trap: Trap) {
        self.traps.push(trap);
    }

    /// Adds an entry to the line map. The map is sorted when it is built; of entries at the same
    /// place the last one counts.
    pub fn line(&mut self, line: Line) {
        self.lines.push(line);
    }

    /// The bytes of the image, unsigned.
    ///
    /// # Errors
    /// The first defect of what it was filled with. Offsets in the error are those of the image that would have been;
    /// record and index say what it is about.
    pub fn build(&self) -> Result<Vec<u8>, ImageError> {
        let file = write::image(self);
        Image::verify(&file)?;
        Ok(file)
    }
}
