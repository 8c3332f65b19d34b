//! An image that has been checked, and what can be read from it.

use crate::address;
use crate::bytes::Record;
use crate::layout::{NO_OFFSET, header, requirements};
use crate::name::{Strings, order};
use crate::object::Object;
use crate::port::Port;
use crate::section::{SectionKind, Sections};
use crate::source::{Line, Trap};
use crate::task::Task;
use crate::types::{Enumerator, Field, Type};
use crate::units::{CodeOffset, TaskId, TypeId};
use crate::variable::{Area, Variable};

/// The author's version of a program.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord)]
pub struct Version {
    /// First number.
    pub major: u16,
    /// Second number.
    pub minor: u16,
    /// Third number.
    pub patch: u16,
}

impl core::fmt::Display for Version {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        write!(f, "{}.{}.{}", self.major, self.minor, self.patch)
    }
}

/// A program image. There is none that has not been checked: see [`Image::parse`].
#[derive(Clone, Copy)]
pub struct Image<'a> {
    pub(crate) file: &'a [u8],
    pub(crate) sections: Sections,
}

impl core::fmt::Debug for Image<'_> {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        write!(f, "Image({} {})", self.name(), self.version())
    }
}

impl<'a> Image<'a> {
    /// All bytes of the image.
    #[must_use]
    pub const fn bytes(&self) -> &'a [u8] {
        self.file
    }

    /// The program's name.
    #[must_use]
    pub fn name(&self) -> &'a str {
        self.strings().get(self.header().text(header::NAME))
    }

    /// The author's version.
    #[must_use]
    pub fn version(&self) -> Version {
        let number = |index: usize| self.header().u16(header::VERSION + 2 * index);
        Version { major: number(0), minor: number(1), patch: number(2) }
    }

    /// The category: a program is replaced only by one of the same category. The numbers are the user's.
    #[must_use]
    pub fn category(&self) -> u32 {
        self.header().u32(header::CATEGORY)
    }

    /// The function that runs once for each start, if there is one.
    #[must_use]
    pub fn init(&self) -> Option<CodeOffset> {
        let offset = self.header().u32(header::INIT);
        (offset != NO_OFFSET).then_some(CodeOffset(offset))
    }

    /// SHA-256 of the image, as the file says. [`Image::verify`] has compared it.
    #[must_use]
    pub fn hash(&self) -> [u8; 32] {
        self.array(header::HASH)
    }

    /// SHA-256 of names, types and offsets of all variables, as the file says. Two images with the same
    /// can take over each other's state.
    #[must_use]
    pub fn layout_hash(&self) -> [u8; 32] {
        self.array(header::LAYOUT_HASH)
    }

    /// The public key of the signature, if the image is signed.
    #[must_use]
    pub fn key(&self) -> Option<[u8; 32]> {
        let key = self.array(header::KEY);
        (key != [0; 32]).then_some(key)
    }

    /// The code.
    #[must_use]
    pub fn code(&self) -> &'a [u8] {
        self.section(SectionKind::Code)
    }

    /// The constants, which lie at [`Image::constants_address`].
    #[must_use]
    pub fn constants(&self) -> &'a [u8] {
        self.section(SectionKind::Constants)
    }

    /// Where the constants lie in the program's address space.
    #[must_use]
    pub fn constants_address(&self) -> u64 {
        address::constants(self.sections[SectionKind::Code.index()].size as u32)
    }

    /// The state's first bytes at a cold start; the rest of it is zero.
    #[must_use]
    pub fn state(&self) -> &'a [u8] {
        self.section(SectionKind::State)
    }

    /// Size of the state in memory, in bytes.
    #[must_use]
    pub const fn state_bytes(&self) -> u32 {
        self.sections[SectionKind::State.index()].memory
    }

    /// Where a segment lies in the file: a multiple of 4096, for mapping its pages as they are. The rest
    /// of its last page is zero.
    #[must_use]
    pub const fn file_offset(&self, kind: SectionKind) -> usize {
        self.sections[kind.index()].offset
    }

    /// Size of this area in bytes: a part of the process image, the state or the constants.
    #[must_use]
    pub fn area_bytes(&self, area: Area) -> u32 {
        let requirement = |field| self.record(SectionKind::Requirements, 0).u32(field);
        match area {
            Area::State => self.state_bytes(),
            Area::Constant => self.sections[SectionKind::Constants.index()].memory,
            Area::Input => requirement(requirements::INPUT),
            Area::Output => requirement(requirements::OUTPUT),
            Area::Marker => requirement(requirements::MARKER),
        }
    }

    /// Where this area lies in the program's address space.
    #[must_use]
    pub fn area_address(&self, area: Area) -> u64 {
        match area {
            Area::State => address::STATE,
            Area::Input => address::INPUT,
            Area::Output => address::OUTPUT,
            Area::Marker => address::MARKER,
            Area::Constant => self.constants_address(),
        }
    }

    /// The tasks, in the order of their numbers.
    pub fn tasks(&self) -> impl ExactSizeIterator<Item = Task<'a>> + use<'a> {
        let image = *self;
        self.indices(SectionKind::Tasks).map(move |index| Task::read(&image, index))
    }

    /// One task.
    #[must_use]
    pub fn task(&self, id: TaskId) -> Option<Task<'a>> {
        self.has(SectionKind::Tasks, id.0.into()).then(|| Task::read(self, id.0.into()))
    }

    /// The variables, in the order of their names (upper and lower case are the same).
    pub fn variables(&self) -> impl ExactSizeIterator<Item = Variable<'a>> + use<'a> {
        let image = *self;
        self.indices(SectionKind::Variables).map(move |index| Variable::read(&image, index))
    }

    /// The variable at this place of the table.
    #[must_use]
    pub fn variable_at(&self, index: u32) -> Option<Variable<'a>> {
        self.has(SectionKind::Variables, index).then(|| Variable::read(self, index))
    }

    /// The variables whose values outlive a start, in the order of their names.
    pub fn retained(&self) -> impl Iterator<Item = Variable<'a>> + use<'a> {
        self.variables().filter(Variable::is_retained)
    }

    /// The variable of this name, found by bisection.
    #[must_use]
    pub fn variable(&self, name: &str) -> Option<Variable<'a>> {
        let (mut low, mut high) = (0, self.sections[SectionKind::Variables.index()].count);
        while low < high {
            let middle = low.midpoint(high);
            let variable = Variable::read(self, middle);
            match order(variable.name, name) {
                core::cmp::Ordering::Equal => return Some(variable),
                core::cmp::Ordering::Less => low = middle + 1,
                core::cmp::Ordering::Greater => high = middle,
            }
        }
        None
    }

    /// The types, in the order of their numbers.
    pub fn types(&self) -> impl ExactSizeIterator<Item = Type<'a>> + use<'a> {
        let image = *self;
        self.indices(SectionKind::Types).map(move |index| Type::read(&image, index))
    }

    /// One type.
    #[must_use]
    pub fn type_of(&self, id: TypeId) -> Option<Type<'a>> {
        self.has(SectionKind::Types, id.0).then(|| Type::read(self, id.0))
    }

    /// The fields of a structure or function block; none of any other type.
    pub fn fields(&self, ty: &Type<'a>) -> impl ExactSizeIterator<Item = Field<'a>> + use<'a> {
        let image = *self;
        ty.fields().map(move |index| Field::read(&image, index))
    }

    /// The values of an enumeration; none of any other type.
    pub fn values(&self, ty: &Type<'a>) -> impl ExactSizeIterator<Item = Enumerator<'a>> + use<'a> {
        let image = *self;
        ty.values().map(move |index| Enumerator::read(&image, index))
    }

    /// The kernel objects, in the order of their numbers.
    pub fn objects(&self) -> impl ExactSizeIterator<Item = Object<'a>> + use<'a> {
        let image = *self;
        self.indices(SectionKind::Objects).map(move |index| Object::read(&image, index))
    }

    /// The channel ports, in the order of their numbers.
    pub fn ports(&self) -> impl ExactSizeIterator<Item = Port<'a>> + use<'a> {
        let image = *self;
        self.indices(SectionKind::Ports).map(move |index| Port::read(&image, index))
    }

    /// The trap map, in the order of the code.
    pub fn traps(&self) -> impl ExactSizeIterator<Item = Trap<'a>> + use<'a> {
        let image = *self;
        self.indices(SectionKind::Traps).map(move |index| Trap::read(&image, index))
    }

    /// The trap at exactly this place of the code, found by bisection.
    #[must_use]
    pub fn trap(&self, at: CodeOffset) -> Option<Trap<'a>> {
        let index = self.last_at_or_before(SectionKind::Traps, at)?;
        Some(Trap::read(self, index)).filter(|trap| trap.at == at)
    }

    /// The line map, in the order of the code.
    pub fn lines(&self) -> impl ExactSizeIterator<Item = Line<'a>> + use<'a> {
        let image = *self;
        self.indices(SectionKind::Lines).map(move |index| Line::read(&image, index))
    }

    /// The source line that this place of the code was made from, if the image says.
    #[must_use]
    pub fn line(&self, at: CodeOffset) -> Option<Line<'a>> {
        let index = self.last_at_or_before(SectionKind::Lines, at)?;
        Some(Line::read(self, index)).filter(|line| line.line != 0)
    }

    /// Both maps begin each record with the offset of the code.
    fn last_at_or_before(&self, kind: SectionKind, at: CodeOffset) -> Option<u32> {
        let (mut low, mut high) = (0, self.sections[kind.index()].count);
        while low < high {
            let middle = low.midpoint(high);
            if self.record(kind, middle).u32(0) <= at.0 { low = middle + 1 } else { high = middle }
        }
        low.checked_sub(1)
    }

    pub(crate) fn header(&self) -> Record<'a> {
        Record::new(self.file, 0)
    }

    pub(crate) fn strings(&self) -> Strings<'a> {
        Strings(self.section(SectionKind::Strings))
    }

    pub(crate) fn section(&self, kind: SectionKind) -> &'a [u8] {
        let section = self.sections[kind.index()];
        let rest = self.file.get(section.offset..).unwrap_or_default();
        rest.get(..section.size).unwrap_or_default()
    }

    pub(crate) fn record(&self, kind: SectionKind, index: u32) -> Record<'a> {
        let (at, size) = (index as usize * kind.record_bytes(), kind.record_bytes());
        let record = self.section(kind).get(at..).and_then(|rest| rest.get(..size));
        let offset = self.sections[kind.index()].offset + at;
        Record::new(record.unwrap_or_default(), offset as u64)
    }

    pub(crate) fn indices(&self, kind: SectionKind) -> IndexRange {
        IndexRange { next: 0, end: self.sections[kind.index()].count }
    }

    fn has(&self, kind: SectionKind, index: u32) -> bool {
        index < self.sections[kind.index()].count
    }

    pub(crate) fn array<const N: usize>(&self, range: core::ops::Range<usize>) -> [u8; N] {
        self.file.get(range).and_then(|bytes| bytes.try_into().ok()).unwrap_or([0; N])
    }
}

/// A range of `u32` that knows its length, which `Range<u32>` does not on all targets.
#[derive(Clone, Debug)]
pub(crate) struct IndexRange {
    pub next: u32,
    pub end: u32,
}

impl Iterator for IndexRange {
    type Item = u32;

    fn next(&mut self) -> Option<u32> {
        (self.next < self.end).then(|| {
            self.next += 1;
            self.next - 1
        })
    }

    fn size_hint(&self) -> (usize, Option<usize>) {
        let left = self.end.saturating_sub(self.next) as usize;
        (left, Some(left))
    }
}

impl ExactSizeIterator for IndexRange {}
