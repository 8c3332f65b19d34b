//! The process image of a program in memory: the kernel's own, and a view of it for each task.
//!
//! A view is what the task finds at the addresses of `%I` and `%Q`. It has pages and a page table of its own, and is
//! exchanged with the task. The markers `%M` are the same for all tasks of a program.

use super::memory::{Area, OutOfMemory, Pages};
use super::program::{LoadError, Region};
use super::space::{Rights, Space, View};
use takt_abi::memory::PAGE;
use takt_kernel::process_image::{cover, merged};
use takt_program::{Area as Kind, Image, address, limit};

const VIEWS: usize = limit::TASKS as usize;
const WORD: u64 = 8;

/// What belongs to one task.
#[derive(Clone, Copy, Debug)]
struct Own {
    view: View,
    input: Area,
    output: Area,
    /// A one for each bit of the outputs that the task writes.
    writes: Area,
}

const NOTHING: Own =
    Own { view: View::NONE, input: Area::NONE, output: Area::NONE, writes: Area::NONE };

/// The process image of a program.
#[derive(Clone, Copy, Debug)]
pub struct Process {
    /// The kernel's own.
    pub input: Area,
    pub output: Area,
    tasks: [Own; VIEWS],
}

impl Process {
    /// That of an image. Its outputs have one writing task each; those of a program with one task are that task's.
    pub fn new(pages: &mut Pages, image: &Image<'_>) -> Result<Self, LoadError> {
        let bytes = |kind| u64::from(image.area_bytes(kind)).next_multiple_of(WORD);
        let (inputs, outputs) = (bytes(Kind::Input), bytes(Kind::Output));
        let mut take = |bytes: u64| -> Result<Area, OutOfMemory> {
            if bytes == 0 { Ok(Area::NONE) } else { Ok(pages.take(bytes)?.first(bytes)) }
        };
        let (input, output) = (take(inputs)?, take(outputs)?);
        let mut process = Self { input, output, tasks: [NOTHING; VIEWS] };
        if inputs + outputs == 0 {
            return Ok(process);
        }
        let alone = image.tasks().len() == 1;
        for (own, task) in process.tasks.iter_mut().zip(image.tasks()) {
            (own.input, own.output, own.writes) = (take(inputs)?, take(outputs)?, take(outputs)?);
            own.view = View::new(take(PAGE)?);
            own.view.map(address::INPUT, own.input, Rights::Constants);
            own.view.map(address::OUTPUT, own.output, Rights::Data);
            // SAFETY: no program sees it, and no other reference to it is ever made.
            let map = unsafe { own.writes.slice() };
            if alone {
                map.fill(0xff);
            }
            let outputs = image.variables().filter(|v| v.area == Kind::Output);
            for variable in outputs.filter(|v| v.writer == Some(task.id)) {
                cover(map, variable.offset, variable.bytes, variable.bit);
            }
        }
        Ok(process)
    }

    /// True if the program has neither inputs nor outputs.
    pub const fn is_empty(&self) -> bool {
        self.input.bytes() + self.output.bytes() == 0
    }

    /// Whose view a task has. The initialisation has that of the first task, which does not run meanwhile.
    pub fn view_of(&self, task: Option<u16>) -> u16 {
        if self.is_empty() { 0 } else { task.unwrap_or(0) }
    }

    fn own(&self, task: Option<u16>) -> Own {
        self.tasks.get(usize::from(task.unwrap_or(0))).copied().unwrap_or(NOTHING)
    }

    /// Lets a task see its view, when the tables are entered the next time.
    pub fn show(&self, space: Space, task: Option<u16>) {
        if !self.is_empty() {
            space.show(self.own(task).view);
        }
    }

    /// What a task finds at the addresses of inputs and outputs.
    pub fn regions(&self, task: Option<u16>) -> [Region; 2] {
        let Own { input, output, .. } = self.own(task);
        [
            Region { address: address::INPUT, area: input, rights: Rights::Constants },
            Region { address: address::OUTPUT, area: output, rights: Rights::Data },
        ]
    }

    /// Some bytes of the kernel's own image.
    pub fn part(&self, kind: Kind, offset: u64, bytes: u64) -> Option<Area> {
        let area = match kind {
            Kind::Input => self.input,
            Kind::Output => self.output,
            _ => return None,
        };
        area.part(offset, bytes)
    }

    /// Gives a task the image as it is now.
    pub fn give(&self, task: Option<u16>) {
        let own = self.own(task);
        own.input.copy_from(self.input);
        own.output.copy_from(self.output);
    }

    /// Takes from a task's view the outputs that it writes; from that of the initialisation all.
    pub fn take(&self, task: Option<u16>) {
        let own = self.own(task);
        if task.is_none() {
            return self.output.copy_from(own.output);
        }
        for at in (0..self.output.bytes()).step_by(WORD as usize) {
            let words = [self.output, own.output, own.writes].map(|area| area.word(at));
            let [image, view, map] = words;
            self.output.set_word(at, merged(image, view, map));
        }
    }
}
