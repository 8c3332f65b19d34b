//! The process image: how a value gets from its place into an input, and from an output to its place.
//!
//! Each program has one image of inputs and one of outputs that belong to the kernel, and each of its tasks a view of
//! both that belongs to the task. A job begins with its inputs read into the program's image, which is then copied
//! into the view; it ends with the outputs that the task writes taken out of the view. So a job sees one instant, and
//! what is seen of it is complete.
//!
//! Here is what happens to the bytes: messages, registers and images come as slices. Whatever a table says, an access
//! outside of a slice does nothing.

use crate::time::Instant;
use takt_abi::io::{ANY_TASK, INPUT, Mapping, OUTPUT, WHOLE, flag, kind};
use takt_program::Elementary;

/// Bytes of the largest value that is not a field of a message.
pub const WORD: usize = 8;

/// Mappings of one place: it is read or written once for all of them.
pub fn places(mappings: &[Mapping]) -> impl Iterator<Item = &[Mapping]> {
    mappings.chunk_by(|a, b| {
        let class = |m: &Mapping| match m.kind {
            kind::FIELD | kind::VALID | kind::AGE => kind::FIELD,
            kind::CAN | kind::CAN_AGE | kind::CAN_COUNT => kind::CAN,
            kind => kind,
        };
        let of = |m: &Mapping| (m.program, m.direction, class(m), m.place, m.width);
        of(a) == of(b)
    })
}

/// True if a job reads this input. Without a task it is that of the initialisation, which reads all.
#[must_use]
pub fn is_read_by(mapping: &Mapping, task: Option<u16>) -> bool {
    mapping.direction == INPUT && (mapping.task == ANY_TASK || is_of(mapping, task))
}

/// True if the end of a job writes this output. Without a task it is that of the initialisation, which writes all.
#[must_use]
pub fn is_written_by(mapping: &Mapping, task: Option<u16>) -> bool {
    mapping.direction == OUTPUT && is_of(mapping, task)
}

fn is_of(mapping: &Mapping, task: Option<u16>) -> bool {
    task.is_none_or(|task| u16::from(mapping.task) == task)
}

/// Where a value lies in some bytes.
#[derive(Clone, Copy)]
struct Location {
    byte: usize,
    bit: u8,
}

impl Location {
    const fn in_image(mapping: &Mapping) -> Self {
        Self { byte: mapping.offset as usize, bit: mapping.bit }
    }

    const fn at_place(mapping: &Mapping) -> Self {
        Self { byte: mapping.field as usize, bit: mapping.place_bit }
    }

    /// A BOOL there.
    fn truth(self, bytes: &[u8]) -> Option<bool> {
        let (byte, mask) = self.mask();
        bytes.get(byte).map(|byte| byte & mask != 0)
    }

    fn set_truth(self, bytes: &mut [u8], value: bool) -> Option<()> {
        let (byte, mask) = self.mask();
        let byte = bytes.get_mut(byte)?;
        *byte = match (self.bit, value) {
            (WHOLE, value) => u8::from(value),
            (_, true) => *byte | mask,
            (_, false) => *byte & !mask,
        };
        Some(())
    }

    /// The byte, and what of it. A bit of a register may be in a later byte than the first.
    fn mask(self) -> (usize, u8) {
        match self.bit {
            WHOLE => (self.byte, 0xff),
            bit => (self.byte.saturating_add(usize::from(bit / 8)), 1 << (bit % 8)),
        }
    }
}

fn copy(m: &Mapping, from: (&[u8], Location), to: (&mut [u8], Location)) -> Option<()> {
    if m.ty == u32::from(Elementary::Bool.code()) {
        return to.1.set_truth(to.0, from.1.truth(from.0)?);
    }
    let range = |at: Location| Some(at.byte..at.byte.checked_add(m.bytes as usize)?);
    to.0.get_mut(range(to.1)?)?.copy_from_slice(from.0.get(range(from.1)?)?);
    Some(())
}

/// Copies an input out of the bytes at its place: a message, a register, or a program's outputs.
pub fn read(mapping: &Mapping, place: &[u8], image: &mut [u8]) {
    let from = (place, Location::at_place(mapping));
    copy(mapping, from, (image, Location::in_image(mapping)));
}

/// Copies an output to the bytes at its place: a message or a register.
pub fn write(mapping: &Mapping, image: &[u8], place: &mut [u8]) {
    let from = (image, Location::in_image(mapping));
    copy(mapping, from, (place, Location::at_place(mapping)));
}

/// Gives a point a value that fits into a word.
pub fn put(mapping: &Mapping, value: [u8; WORD], image: &mut [u8]) {
    let at_start = Mapping { field: 0, place_bit: WHOLE, ..*mapping };
    read(&at_start, &value, image);
}

/// Makes a point zero.
pub fn clear(mapping: &Mapping, image: &mut [u8]) {
    let at = Location::in_image(mapping);
    if mapping.ty == u32::from(Elementary::Bool.code()) {
        at.set_truth(image, false);
    } else if let Some(point) = image.get_mut(at.byte..).and_then(|rest| {
        let bytes = rest.len().min(mapping.bytes as usize);
        rest.get_mut(..bytes)
    }) {
        point.fill(0);
    }
}

/// What is known of the newest message of a channel, or of the newest frame of a CAN object.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Newest<'a> {
    /// The message; none if there is none of the full length.
    pub message: Option<&'a [u8]>,
    /// It is there and young enough.
    pub valid: bool,
    /// Nanoseconds since it was written; the largest number if there is none.
    pub age: u64,
    /// Of an object, how often it was received.
    pub count: u32,
}

impl Newest<'_> {
    /// There is no message.
    pub const NONE: Self = Self { message: None, valid: false, age: i64::MAX as u64, count: 0 };
}

/// Gives an input of a channel or an object its value.
pub fn read_newest(mapping: &Mapping, newest: &Newest<'_>, image: &mut [u8]) {
    match mapping.kind {
        kind::VALID => put(mapping, u64::from(newest.valid).to_le_bytes(), image),
        kind::CAN_COUNT => put(mapping, u64::from(newest.count).to_le_bytes(), image),
        kind::AGE | kind::CAN_AGE => put(mapping, newest.age.to_le_bytes(), image),
        _ if !newest.valid && mapping.flags & flag::ZERO != 0 => clear(mapping, image),
        _ => {
            if let Some(message) = newest.message {
                read(mapping, message, image);
            }
        }
    }
}

/// The simulated value of an input at an instant; none if the mapping is of another kind.
#[must_use]
pub fn simulated(mapping: &Mapping, now: Instant) -> Option<[u8; WORD]> {
    let (low, high) = (f64::from_bits(mapping.place), f64::from_bits(mapping.high));
    let phase = match now.0.checked_rem(mapping.period_ns) {
        Some(past) => past as f64 / mapping.period_ns as f64,
        None => 0.0,
    };
    // Rounding and the sine's error must not lead out of the limits.
    let within = |value: f64| value.max(low.min(high)).min(low.max(high));
    let value = match mapping.kind {
        kind::CONSTANT => low,
        kind::RAMP => within(low + (high - low) * phase),
        kind::SINE => within(low + (high - low) * (0.5 + 0.5 * sine(phase))),
        kind::SQUARE if phase < 0.5 => low,
        kind::SQUARE => high,
        _ => return None,
    };
    Some(number(mapping.ty, value))
}

/// The sine of a part of a turn, from 0 to 1, to 4 millionths: there is no library for it here.
fn sine(turn: f64) -> f64 {
    // To the quarter of a turn on both sides of 0, by symmetry.
    let turn = match turn {
        turn if turn < 0.25 => turn,
        turn if turn < 0.75 => 0.5 - turn,
        turn => turn - 1.0,
    };
    let x = turn * core::f64::consts::TAU;
    let square = x * x;
    x * (1.0 - square / 6.0 * (1.0 - square / 20.0 * (1.0 - square / 42.0 * (1.0 - square / 72.0))))
}

/// A number in the bytes of an elementary type: rounded, and at most as large as the type allows.
fn number(ty: u32, value: f64) -> [u8; WORD] {
    use Elementary::{Bool, Dint, Int, Lint, Lreal, Ltime, Real, Sint, Time};
    // Half away from zero; a conversion to an integer ends at the limits of its type.
    let rounded = if value < 0.0 { value - 0.5 } else { value + 0.5 };
    let unsigned = |most: u64| (rounded as u64).min(most).to_le_bytes();
    let signed = |least: i64, most: i64| (rounded as i64).clamp(least, most).to_le_bytes();
    match u8::try_from(ty).ok().and_then(Elementary::from_code) {
        Some(Bool) => u64::from(value >= 0.5).to_le_bytes(),
        Some(Real) => u64::from((value as f32).clamp(f32::MIN, f32::MAX).to_bits()).to_le_bytes(),
        Some(Lreal) => value.to_bits().to_le_bytes(),
        Some(Sint) => signed(i8::MIN.into(), i8::MAX.into()),
        Some(Int) => signed(i16::MIN.into(), i16::MAX.into()),
        Some(Dint) => signed(i32::MIN.into(), i32::MAX.into()),
        Some(Lint | Time | Ltime) => signed(i64::MIN, i64::MAX),
        Some(other) => unsigned(u64::MAX >> (64 - 8 * other.bytes().clamp(1, 8))),
        None => [0; WORD],
    }
}

/// Marks a point in a map of the outputs that a task writes. The map has a one for each of their bits.
pub fn cover(map: &mut [u8], offset: u32, bytes: u32, bit: Option<u8>) {
    let from = offset as usize;
    if let (Some(bit), Some(byte)) = (bit, map.get_mut(from)) {
        *byte |= 1 << (bit & 7);
    } else if let Some(covered) = map.get_mut(from..from.saturating_add(bytes as usize)) {
        covered.fill(0xff);
    }
}

/// The word of an image after a job: what the job's task writes of it comes from its view.
#[must_use]
pub const fn merged(image: u64, view: u64, map: u64) -> u64 {
    image & !map | view & map
}
