//! From the host's table of programs to tasks that can run.
//!
//! Everything is taken and checked before the first task runs. If one program cannot be loaded none is
//! started, and the guest ends itself: a plant that is controlled by half of its programs is none.

use super::context::{self};
use super::events::Source;
use super::io::Io;
use super::kernel::{Kernel, Place};
use super::memory::{Pages, Ram};
use super::program::{LoadError, Program};
use super::{processor, space};
use takt_abi::interrupt_controller::VECTORS;
use takt_abi::memory::{PAGE, PROGRAM_TABLE};
use takt_abi::program::ProgramTable;
use takt_abi::{MAGIC, VERSION, start};
use takt_kernel::objects::Object;
use takt_kernel::scheduler::Full;
use takt_kernel::task::{ProgramId, Release, Settings, TaskId};
use takt_kernel::time::Span;
use takt_plc_guest::console::print;
use takt_plc_guest::{interrupt, pages, port};
use takt_program::{Elementary, EventSource, Image, ObjectKind, Start, Task, TaskKind, TypeKind};

/// Vector of the interrupt at a window's start: the first that is no exception.
const TICK_VECTOR: u8 = 32;
/// Exit code of a kernel that cannot run what it was given.
const CANNOT_START: u32 = 3;
/// Initialisations are less urgent than all tasks.
const LEAST_URGENT: u8 = 255;

impl From<Full> for LoadError {
    fn from(_: Full) -> Self {
        Self::TooMany
    }
}

impl Kernel {
    /// Loads all programs, and runs them.
    pub fn start(&mut self) -> ! {
        let information = pages::information();
        self.start = if information.start_mode == start::WARM { Start::Warm } else { Start::Cold };
        // SAFETY: the host provides the page, read-only and filled before the start, to a guest that has
        // programs; every bit pattern is a table.
        let table = unsafe { (PROGRAM_TABLE as *const ProgramTable).read_volatile() };
        if (table.magic, table.version) != (MAGIC, VERSION) {
            print(format_args!("this kernel needs programs of interface version {VERSION}"));
            port::exit(CANNOT_START);
        }
        // SAFETY: this is ring 0, this function does not return, and the root is in the image.
        let ram = unsafe {
            processor::protect();
            context::install(TICK_VECTOR);
            Ram::map(space::boot_root(), information.memory_bytes)
        };
        self.live.open();
        let Some(io) = Io::open(&mut self.ports, 1000 * information.tsc_khz) else {
            print(format_args!(
                "this kernel needs inputs and outputs of interface version {VERSION}"
            ));
            port::exit(CANNOT_START);
        };
        self.io = io;
        let count = (table.count as usize).min(table.programs.len());
        for (place, entry) in (0..).zip(&table.programs[..count]) {
            let name = entry.name.iter().take_while(|byte| **byte != 0).count();
            if let Err(error) = self.load(ram, &table, place, entry) {
                let name = core::str::from_utf8(&entry.name[..name]).unwrap_or("?");
                print(format_args!("program {name} cannot be run: {error}"));
                port::exit(CANNOT_START);
            }
        }
        let images = || self.programs.iter().flatten().map(|program| &program.image);
        print(format_args!(
            "Takt PLC kernel: {count} programs, {} tasks, {} objects",
            images().map(|image| image.tasks().len()).sum::<usize>(),
            images().map(|image| image.objects().len()).sum::<usize>()
        ));
        interrupt::end_later();
        port::write(takt_abi::port::TICK, TICK_VECTOR.into());
        self.run()
    }

    fn load(
        &mut self,
        ram: Ram,
        table: &ProgramTable,
        place: u8,
        entry: &takt_abi::program::Program,
    ) -> Result<(), LoadError> {
        if self.pages.is_none() {
            let work = ram.area(table.work, table.work_bytes).ok_or(LoadError::Table)?;
            let mut pages = Pages::new(work);
            self.call_page = super::program::call_page(ram, &mut pages)?;
            self.pages = Some(pages);
        }
        let pages = self.pages.as_mut().ok_or(LoadError::Memory)?;
        let mut program = Program::load(ram, pages, self.call_page, ProgramId(place), entry)?;
        let image = program.image;
        let id = self.scheduler.add_program(image.objects().map(|object| match object.kind {
            ObjectKind::Semaphore { ceiling } => Object::semaphore(ceiling),
            ObjectKind::Queue { depth, .. } => Object::queue(depth),
            ObjectKind::Mailbox { .. } => Object::mailbox(),
            ObjectKind::Flags => Object::Flags(0),
        }))?;
        if let Some(entry) = image.init() {
            let settings = Settings {
                program: id,
                release: Release::Start,
                priority: LEAST_URGENT,
                deadline: Span::ZERO,
                budget: Span::ZERO,
                sensitivity: 0,
            };
            self.add(settings, program.place(None, entry))?;
        }
        for task in image.tasks() {
            self.add_task(id, &task, &program)?;
        }
        self.open_ports(place, &image, program.name());
        program.start = program.start_of(self.start);
        while !program.load_some() {}
        self.programs[usize::from(place)] = Some(program);
        Ok(())
    }

    fn add(&mut self, settings: Settings, place: Place) -> Result<TaskId, LoadError> {
        let id = self.scheduler.add_task(settings)?;
        self.places[id.index()] = place;
        Ok(id)
    }

    fn add_task(
        &mut self,
        id: ProgramId,
        task: &Task<'_>,
        program: &Program,
    ) -> Result<(), LoadError> {
        let settings = settings_of(id, task);
        let new = self.add(settings, program.place(Some(task.id.0), task.entry))?;
        if let TaskKind::Event { source, .. } = task.kind {
            let source = source_of(program, source, self.io.vector(id.0, task.id.0))?;
            if !self.events.add(new, id.0, source) {
                return Err(LoadError::TooMany);
            }
        }
        Ok(())
    }

    fn open_ports(&mut self, place: u8, image: &Image<'_>, name: &str) {
        for (number, port) in (0..).zip(image.ports()) {
            if let Err(code) = self.ports.open(place, number, &port) {
                print(format_args!("program {name}: its port {} is closed: {code:?}", port.name));
            }
        }
    }
}

/// What the scheduler knows of a task of an image.
pub fn settings_of(program: ProgramId, task: &Task<'_>) -> Settings {
    let release = match task.kind {
        TaskKind::Cyclic { period, offset } => {
            Release::Cyclic { period: Span(period.0), offset: Span(offset.0) }
        }
        TaskKind::Event { minimum, .. } => Release::Event { minimum: Span(minimum.0) },
        TaskKind::Freewheeling => Release::Freewheeling,
    };
    Settings {
        program,
        release,
        priority: task.priority,
        deadline: task.deadline.map_or(Span::ZERO, |deadline| Span(deadline.0)),
        budget: task.budget.map_or(Span::ZERO, |budget| Span(budget.0)),
        sensitivity: task.sensitivity,
    }
}

/// Where the kernel looks for an event; `vector` is that of the interrupt by which the host's table releases the task.
fn source_of(
    program: &Program,
    source: EventSource<'_>,
    vector: Option<u8>,
) -> Result<Source, LoadError> {
    let image = &program.image;
    match source {
        EventSource::Channel(name) => {
            let number = image.ports().position(|port| port.name == name);
            number
                .map(|number| Source::Port { number: number as u8, seen: 0 })
                .ok_or(LoadError::Source("a port"))
        }
        EventSource::Rise(name) => {
            let variable = image.variable(name).ok_or(LoadError::Source("a variable"))?;
            // Of an input or an output the kernel's own, which the jobs of all tasks have read and written.
            let byte = program
                .process
                .part(variable.area, variable.offset.into(), 1)
                .or_else(|| program.memory(None, variable.address(image), 1, false));
            let byte = byte.ok_or(LoadError::Source("a variable"))?;
            // Without a bit of its own a BOOL is a byte.
            let is_bool = image
                .type_of(variable.ty)
                .is_some_and(|ty| ty.kind == TypeKind::Elementary(Elementary::Bool));
            let mask = variable.bit.map_or(if is_bool { 0xff } else { 0 }, |bit| 1 << (bit & 7));
            Ok(Source::Rise { byte, mask, last: false })
        }
        EventSource::Doorbell(_) => Err(LoadError::Source("a doorbell")),
        EventSource::Interrupt(_) => vector
            .filter(|vector| VECTORS.contains(vector) && *vector != TICK_VECTOR)
            .map(|vector| Source::Interrupt { vector, armed: false })
            .ok_or(LoadError::Source("an interrupt")),
    }
}

const _: () = assert!(size_of::<ProgramTable>() as u64 <= PAGE);
