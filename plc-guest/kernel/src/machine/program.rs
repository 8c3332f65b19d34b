//! A program in memory: what the image says, put where the program sees it.
//!
//! Code and constants are the pages of the image itself. The state has pages of its own, into which the
//! initial bytes are copied at each start, some at a time, so that a program that starts anew takes no
//! time from its neighbours.

use super::context::Start as JobStart;
use super::kernel::{Place, Shown};
use super::memory::{Area, OutOfMemory, Pages, Ram};
use super::process::Process;
use super::retain::Loading;
use super::space::{Rights, Space};
use core::fmt;
use core::mem::offset_of;
use takt_abi::live;
use takt_abi::memory::PAGE;
use takt_abi::program as table;
use takt_change::cost::{GATHER_BYTES, SAVED_BYTES};
use takt_kernel::scheduler::OBJECTS_EACH_MAX;
use takt_kernel::task::ProgramId;
use takt_program::{
    ABI_VERSION, Area as Kind, CodeOffset, Image, ImageError, ObjectKind, SectionKind, Start,
    TaskId, TaskInformation,
};
use takt_program::{address, limit};

/// `xor eax, eax; syscall; ud2`: the end of a job, to which a task returns.
const CALL_PAGE: [u8; 6] = [0x31, 0xc0, 0x0f, 0x05, 0x0f, 0x0b];
/// What is copied at a time of the state of a program that starts anew.
const STEP: u64 = PAGE;

/// Memory of a program, where the program sees it.
#[derive(Clone, Copy, Debug)]
pub struct Region {
    pub address: u64,
    pub area: Area,
    pub rights: Rights,
}

const NO_REGION: Region = Region { address: 0, area: Area::NONE, rights: Rights::Constants };
/// Code, constants, state, markers, the information of the tasks.
const FIXED: usize = 5;
const MARKER: usize = 3;
const REGIONS: usize = FIXED + limit::TASKS as usize;
/// Places of regions that a change of the version replaces.
pub const CODE: usize = 0;
pub const CONSTANTS: usize = 1;
pub const STATE: usize = 2;
const ROOM_BYTES: u64 = GATHER_BYTES as u64 + SAVED_BYTES as u64;

/// Why a program cannot be run.
#[derive(Debug)]
pub enum LoadError {
    /// The host's table names memory that there is not.
    Table,
    /// The image is none.
    Image(ImageError),
    /// There is nothing to run in it.
    NoTasks,
    /// A task waits for something that the kernel does not know.
    Source(&'static str),
    /// The partition has more tasks or objects than the kernel has room for.
    TooMany,
    /// The partition has too little memory.
    Memory,
}

impl From<OutOfMemory> for LoadError {
    fn from(_: OutOfMemory) -> Self {
        Self::Memory
    }
}

impl fmt::Display for LoadError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Table => {
                f.write_str("the host's table of programs names memory that there is not")
            }
            Self::Image(error) => write!(f, "its image is not valid: {error}"),
            Self::NoTasks => f.write_str("it has no tasks"),
            Self::Source(kind) => {
                write!(f, "one of its tasks waits for {kind}, which this kernel does not do yet")
            }
            Self::TooMany => write!(
                f,
                "the programs have more than {} tasks (with one for the start of each program) or {} \
                 objects together",
                super::TASKS,
                super::OBJECTS
            ),
            Self::Memory => f.write_str("the partition's memory is too small"),
        }
    }
}

/// The page to which all tasks return.
pub fn call_page(ram: Ram, pages: &mut Pages) -> Result<Area, OutOfMemory> {
    let page = pages.take(PAGE)?;
    page.write(&CALL_PAGE);
    ram.write_protect(pages, page)?;
    Ok(page)
}

/// A program that can run.
#[derive(Debug)]
pub struct Program {
    pub id: ProgramId,
    pub image: Image<'static>,
    pub space: Space,
    /// Its inputs and outputs.
    pub process: Process,
    /// The host's entry: name, and what follows from errors.
    pub entry: table::Program,
    /// Memory for the messages of each object.
    pub messages: [Area; OBJECTS_EACH_MAX as usize],
    /// The bank in use, and the other one.
    pub banks: [Area; 2],
    /// All memory for the state, of which a version may use a part.
    pub state_memory: Area,
    /// As much for the state of another version, if the partition file gives it.
    pub second_state: Area,
    /// For the values that a change moves, and then for those that it puts aside; with a second state for what is known of
    /// each page.
    pub room: Area,
    pub regions: [Region; REGIONS],
    information: Area,
    /// What is known to have been used of each stack, in bytes, and how far from its top it was looked at since.
    stacks_used: [(u64, u64); limit::TASKS as usize],
    /// The block of its retained variables, and what of it the state gets at this start.
    pub retained: Area,
    pub restored: u32,
    /// How it was started last.
    pub start: Start,
    /// How far the state has been set up; none: all of it.
    pub loading: Option<Loading>,
    /// Release of the window in which it failed last. One that fails in its initialisation again and again would
    /// take windows whole if it started anew in the same one.
    failed_in: Option<u64>,
    /// Lines that it may log, and those that were too many.
    pub lines: super::lines::Allowance,
    /// The same for lines that tell of its faults, and of limits that its jobs have not kept, so that it cannot hide one by
    /// logging.
    pub fault_lines: super::lines::Allowance,
    pub violation_lines: super::lines::Allowance,
}

impl Program {
    /// Maps an image. Its tasks and objects are not in the scheduler yet.
    pub fn load(
        ram: Ram,
        pages: &mut Pages,
        call_page: Area,
        id: ProgramId,
        entry: &table::Program,
    ) -> Result<Self, LoadError> {
        let bank = ram.area(entry.image, entry.bank_bytes).ok_or(LoadError::Table)?;
        let file = bank.part(0, entry.image_bytes).ok_or(LoadError::Table)?;
        let other = ram.area(entry.second_bank, entry.bank_bytes).ok_or(LoadError::Table)?;
        let state = ram.area(entry.state, entry.state_bytes).ok_or(LoadError::Table)?;
        let second_state = match entry.second_state {
            0 => Area::NONE,
            at => ram.area(at, entry.state_bytes).ok_or(LoadError::Table)?,
        };
        let retained = match entry.retained_bytes {
            0 => Area::NONE,
            bytes => ram.area(entry.retained, bytes).ok_or(LoadError::Table)?,
        };
        // SAFETY: the host writes to the bank in use before the start only, and no program has a right to
        // write there.
        let image = Image::parse(unsafe { file.bytes_for_ever() }).map_err(LoadError::Image)?;
        if image.tasks().len() == 0 {
            return Err(LoadError::NoTasks);
        }
        let mut program = Self {
            id,
            image,
            space: Space::new(pages, entry.bank_bytes, [state.bytes(), second_state.bytes()])?,
            process: Process::new(pages, &image)?,
            banks: [bank, other],
            state_memory: state,
            second_state,
            room: pages.take(ROOM_BYTES)?,
            entry: *entry,
            messages: [Area::NONE; OBJECTS_EACH_MAX as usize],
            regions: [NO_REGION; REGIONS],
            information: pages.take(PAGE)?,
            stacks_used: [(0, 0); limit::TASKS as usize],
            retained,
            restored: entry.restored,
            start: Start::Cold,
            loading: Some(Loading::FIRST),
            failed_in: None,
            lines: super::lines::Allowance::FULL,
            fault_lines: super::lines::Allowance::FULL,
            violation_lines: super::lines::Allowance::FULL,
        };
        program.map_fixed(pages, bank, state, call_page)?;
        ram.write_protect(pages, bank)?;
        ram.write_protect(pages, other)?;
        program.map_stacks(pages)?;
        program.take_messages(pages)?;
        Ok(program)
    }

    fn map_fixed(
        &mut self,
        pages: &mut Pages,
        bank: Area,
        state: Area,
        call_page: Area,
    ) -> Result<(), LoadError> {
        let image = self.image;
        let segment = |kind, bytes: usize| {
            let bytes = address::pages(bytes as u64);
            bank.part(image.file_offset(kind) as u64, bytes).ok_or(LoadError::Table)
        };
        let code = segment(SectionKind::Code, image.code().len())?;
        let constants = segment(SectionKind::Constants, image.constants().len())?;
        let state_bytes = address::pages(image.state_bytes().into());
        let state = state.part(0, state_bytes).ok_or(LoadError::Table)?;
        let marker = match image.area_bytes(Kind::Marker) {
            0 => Area::NONE,
            bytes => pages.take(bytes.into())?,
        };
        let fixed: [(u64, Area, Rights); FIXED] = [
            (address::CODE, code, Rights::Code),
            (image.constants_address(), constants, Rights::Constants),
            (address::STATE, state, Rights::Data),
            (address::MARKER, marker, Rights::Data),
            (address::TASK_INFORMATION, self.information, Rights::Constants),
        ];
        self.space.map(pages, address::CALL_PAGE, call_page, Rights::Code)?;
        for (slot, (address, area, rights)) in fixed.into_iter().enumerate() {
            self.map(pages, slot, Region { address, area, rights })?;
        }
        Ok(())
    }

    fn map_stacks(&mut self, pages: &mut Pages) -> Result<(), LoadError> {
        for task in self.image.tasks() {
            let area = pages.take(task.stack_bytes.into())?;
            let address = address::stack_end(task.id) - area.bytes();
            let region = Region { address, area, rights: Rights::Data };
            self.map(pages, FIXED + usize::from(task.id.0), region)?;
        }
        Ok(())
    }

    fn map(&mut self, pages: &mut Pages, slot: usize, region: Region) -> Result<(), LoadError> {
        *self.regions.get_mut(slot).ok_or(LoadError::TooMany)? = region;
        Ok(self.space.map(pages, region.address, region.area, region.rights)?)
    }

    fn take_messages(&mut self, pages: &mut Pages) -> Result<(), LoadError> {
        for (slot, object) in self.messages.iter_mut().zip(self.image.objects()) {
            let bytes = match object.kind {
                ObjectKind::Queue { message_bytes, depth } => {
                    table::queue_bytes(message_bytes, depth)
                }
                ObjectKind::Mailbox { bytes } => table::mailbox_bytes(bytes),
                ObjectKind::Semaphore { .. } | ObjectKind::Flags => continue,
            };
            *slot = pages.take(bytes)?;
        }
        Ok(())
    }

    /// An area that can be looked at from outside.
    pub const fn live_area(&self, area: live::Area) -> Area {
        match area {
            live::Area::State => self.regions[STATE].area,
            live::Area::Input => self.process.input,
            live::Area::Output => self.process.output,
            live::Area::Marker => self.regions[MARKER].area,
        }
    }

    /// Its name in the partition.
    pub fn name(&self) -> &str {
        let end = self.entry.name.iter().position(|byte| *byte == 0).unwrap_or(table::NAME_BYTES);
        core::str::from_utf8(&self.entry.name[..end]).unwrap_or("?")
    }

    /// Memory of the program that a task names by a pointer, if all of it may be accessed so.
    pub fn memory(&self, task: Option<u16>, pointer: u64, bytes: u64, write: bool) -> Option<Area> {
        let regions = self.regions.iter().copied().chain(self.process.regions(task));
        let found = regions.into_iter().find_map(|region| {
            let allowed = !write || region.rights == Rights::Data;
            let offset = pointer.checked_sub(region.address)?;
            let found = region.area.part(offset, bytes).filter(|_| allowed)?;
            if write && region.address == address::STATE {
                self.state_is_written(offset, bytes);
            }
            Some(found)
        });
        // Nothing is a part of everything.
        if bytes == 0 { Some(Area::NONE) } else { found }
    }

    /// The kernel writes to these bytes of the state.
    pub fn state_is_written(&self, offset: u64, bytes: u64) {
        if self.second_state != Area::NONE {
            self.space.set_written(false, offset, bytes);
        }
    }

    /// The stack of a task of the image.
    pub fn stack(&self, number: u16) -> Area {
        self.regions.get(FIXED + usize::from(number)).map_or(Area::NONE, |region| region.area)
    }

    /// Looks one page further down a task's stack, which was zero at first: what is the most that has ever
    /// been used of it, in bytes? Known after as many looks as it has pages: below a page of zeros there may be used ones.
    pub fn look_at_stack(&mut self, number: u16) -> u64 {
        let stack = self.stack(number);
        let Some((used, looked)) = self.stacks_used.get_mut(usize::from(number)) else { return 0 };
        let end = stack.bytes() - *looked;
        let mut page = end.saturating_sub(PAGE)..end;
        *looked = stack.bytes() - page.start;
        if let Some(lowest) = page.by_ref().step_by(8).find(|offset| stack.word(*offset) != 0) {
            *used = (*used).max(stack.bytes() - lowest);
        }
        if *looked == stack.bytes() {
            *looked = *used / PAGE * PAGE;
        }
        *used
    }

    /// Where a task is in its image, which has it at this entry.
    pub fn place(&self, number: Option<u16>, entry: CodeOffset) -> Place {
        let stack = self.stack(number.unwrap_or(0));
        let at = address::task_information(number.map(TaskId)) - address::TASK_INFORMATION;
        Place {
            program: self.id.0,
            number,
            start: JobStart {
                entry: address::CODE + u64::from(entry.0),
                stack: address::stack_end(TaskId(number.unwrap_or(0))) - 8,
                argument: address::task_information(number.map(TaskId)),
            },
            stack_top: stack.part(stack.bytes() - 8, 8).unwrap_or(Area::NONE),
            information: self
                .information
                .part(at, size_of::<TaskInformation>() as u64)
                .unwrap_or(Area::NONE),
            has_image: !self.process.is_empty(),
            shown: Shown::new(self.id.0, self.process.view_of(number)),
        }
    }

    /// Tells all tasks what is the same for all their jobs until the program starts anew.
    pub fn inform(&self) {
        let tasks = self.image.tasks().map(|task| Some(task.id.0)).chain([None]);
        for number in tasks {
            let at = address::task_information(number.map(TaskId)) - address::TASK_INFORMATION;
            let task = number.map_or(TaskInformation::INIT, u32::from);
            let first = u64::from(ABI_VERSION) | u64::from(task) << 32;
            self.information.set_words(at, [first]);
            let start = at + offset_of!(TaskInformation, start) as u64;
            self.information.set_words(start, [self.start as u64]);
        }
    }

    /// Its state is to be set up again, after the window of this release.
    pub fn reload(&mut self, release: u64, start: Start) {
        self.loading = Some(Loading::ANEW);
        self.failed_in = Some(release);
        self.start = start;
        self.restored = match start {
            Start::Warm => table::restored::ALL,
            Start::Cold => table::restored::PERSISTENT,
        };
    }

    /// True if some of its state can be set up in the window of this release.
    pub fn can_load(&self, release: u64) -> bool {
        self.is_loading() && self.failed_in != Some(release)
    }

    /// True if its state is not set up yet.
    pub const fn is_loading(&self) -> bool {
        self.loading.is_some()
    }

    /// Gives some more of the state its initial values, and then of markers, inputs and outputs. Returns where it goes on.
    pub fn initialise(&mut self, done: u64) -> Option<u64> {
        let state = self.regions[STATE].area;
        let areas = [state, self.regions[MARKER].area, self.process.input, self.process.output];
        let (mut at, mut begin) = (done, 0);
        for area in areas {
            if at < area.bytes() {
                let length = STEP.min(area.bytes() - at);
                let part = area.part(at, length).unwrap_or(Area::NONE);
                part.clear();
                if begin == 0 {
                    let from = self.image.state().get(at as usize..).unwrap_or(&[]);
                    part.write(&from[..from.len().min(length as usize)]);
                }
                return Some(begin + at + length);
            }
            (at, begin) = (at - area.bytes(), begin + area.bytes());
        }
        None
    }
}
