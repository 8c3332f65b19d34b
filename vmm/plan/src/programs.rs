//! The programs of a PLC: images that are read, checked and kept, as the guest will find them.
//!
//! An image is read once, before anything is started, and its bytes are what the guest gets, at the first
//! start and at every later one: a file that is changed or gone by then changes nothing. It is the work of a
//! stranger until its hash has been compared and, where the file names keys, its signature.

use std::fmt;
use std::io::{self, Read};
use std::path::PathBuf;
use std::sync::Arc;

use takt_abi::live::SAMPLE_BYTES;
use takt_abi::memory::PAGE;
use takt_abi::program::{self, PROGRAMS_MAX, action};
use takt_program::{Area, Image, ObjectKind, limit};
use toml::Spanned;

use super::diagnostic::{Diagnostic, Span, quote};
use super::images::{self, Unreadable};
use super::names::check_word;
use super::partition::Surroundings;
use super::raw::{self, Keys};
use super::retain::{self, RetainFile};
use super::units::Bytes;

/// Most keys that a program's signature may be of.
const KEYS_MAX: usize = 16;
/// Longest image: its segments, the longest of its tables, and room to spare.
const IMAGE_MAX: u64 = 192 << 20;
/// What one page table maps.
const TABLE: u64 = 2 << 20;
/// What a bank and the memory for the state are a multiple of, where the file gives no size.
const STEP: u64 = 64 << 10;

/// The public keys that a program's images may be signed with; `None`: all, and none at all.
pub type AcceptedKeys = Option<Vec<[u8; 32]>>;

/// A program of a PLC.
#[derive(Clone)]
pub struct Program {
    /// Unique among the programs of the partition, of the form of all names.
    pub name: String,
    /// Absolute path of the image.
    pub path: PathBuf,
    /// Where it lies in the guest, with what follows from its errors.
    pub place: program::Program,
    /// Whether the image is signed by a key that the file accepts.
    pub trust: Trust,
    /// How much of it clients of the control socket may have looked at in a cycle.
    pub watch: Bytes,
    /// Whether they may write and force its values.
    pub allow_force: bool,
    /// Where its retained values are written, if they are to outlive a stop of Takt.
    pub retain: Option<RetainFile>,
    /// The keys that the file accepts; `None`: it accepts any, and images without a signature.
    pub keys: AcceptedKeys,
    image: Arc<[u8]>,
}

/// Without the bytes of the image, of which there may be millions.
impl fmt::Debug for Program {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let mut shown = f.debug_struct("Program");
        shown.field("name", &self.name).field("path", &self.path).field("place", &self.place);
        shown.field("trust", &self.trust).finish_non_exhaustive()
    }
}

impl Program {
    /// The bytes of the image. They are valid: [`image`](Self::image) reads them.
    #[must_use]
    pub fn bytes(&self) -> &[u8] {
        &self.image
    }

    /// Bytes of its state, inputs, outputs and markers.
    #[must_use]
    pub fn area_bytes(&self) -> [u32; 4] {
        let image = self.image();
        let bytes = |area| image.map_or(0, |image| image.area_bytes(area));
        [Area::State, Area::Input, Area::Output, Area::Marker].map(bytes)
    }

    /// The image; `None` never happens, since it was valid when the file was loaded.
    #[must_use]
    pub fn image(&self) -> Option<Image<'_>> {
        Image::parse(&self.image).ok()
    }
}

/// By what an image is trusted.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Trust {
    /// It is signed with a key that the file names.
    Signed([u8; 32]),
    /// The file names no keys, and it is signed.
    NotAsked,
    /// The file names no keys, and it is not signed.
    Unsigned,
}

/// A program that obeys its own rules, with the places that later rules point at.
#[derive(Debug)]
pub struct CheckedProgram {
    pub program: Program,
    /// The value of `image`.
    pub span: Span,
    /// The value of `retain`.
    pub retain: Option<Span>,
    /// What the guest needs for it in its working area, in bytes.
    pub work: u64,
    /// Whether another version may have a state of its own.
    pub second_state: bool,
}

/// Reads and checks the programs of a partition, in the order of the file.
pub fn check(
    tables: &[Spanned<Keys<raw::Program>>],
    around: Surroundings<'_>,
) -> Result<Vec<CheckedProgram>, Diagnostic> {
    if let Some(excess) = tables.get(PROGRAMS_MAX) {
        let found = format!("this is program {} of {}", PROGRAMS_MAX + 1, tables.len());
        let allowed = format!("at most {PROGRAMS_MAX} tables [[partition.program]] in a partition");
        return Err(Diagnostic::new(excess.span(), found, allowed));
    }
    let mut checked: Vec<CheckedProgram> = Vec::with_capacity(tables.len());
    let mut retained = retain::Sum::default();
    for table in tables {
        let Keys(raw) = table.get_ref();
        let next = check_one(raw, around, &mut retained)?;
        if let Some(other) = checked.iter().find(|p| p.program.name == next.program.name) {
            let found =
                format!("a second program of the partition is named {}", quote(&next.program.name));
            let allowed = "a name of its own for each program, by the key `name`";
            return Err(Diagnostic::new(name_span(raw), found, allowed)
                .and(other.span.clone(), "the other one"));
        }
        checked.push(next);
    }
    Ok(checked)
}

fn check_one(
    raw: &raw::Program,
    around: Surroundings<'_>,
    retained: &mut retain::Sum,
) -> Result<CheckedProgram, Diagnostic> {
    let file = images::resolve(around.folder, &raw.image)?;
    let replacement = around.replacement.filter(|replacement| replacement.path == file.path);
    let bytes = match replacement {
        Some(replacement) => read(replacement.bytes).map_err(Unreadable::from),
        None => images::open(&file.path).and_then(|opened| Ok(read(opened)?)),
    };
    let bytes = bytes.map_err(|error| images::unreadable(&file, &error))?;
    let image = Image::verify(&bytes).map_err(|error| {
        let found = format!("{} is no program image: {error}", file.path.display());
        let allowed = "a program image of version 1, as `takt plc build` and the SDK make them";
        Diagnostic::new(raw.image.span(), found, allowed)
    })?;
    let name = name(raw, &image)?.to_owned();
    let (trust, keys) = check_key(raw, &image)?;
    let length = bytes.len() as u64;
    let bank = area("bank", raw.bank.as_ref(), length, "an image", &raw.image)?;
    let state = u64::from(image.state_bytes());
    let state = area("state", raw.state.as_ref(), state, "a state", &raw.image)?;
    let place = program::Program {
        name: padded(&name),
        image_bytes: length,
        bank_bytes: bank,
        state_bytes: state,
        retained_bytes: retained.add(raw, &image)?,
        on_fault: check_action("on_fault", raw.on_fault.as_ref(), &FAULT_ACTIONS)?,
        on_overrun: check_action("on_overrun", raw.on_overrun.as_ref(), &OVERRUN_ACTIONS)?,
        on_deadline: check_action("on_deadline", raw.on_deadline.as_ref(), &DEADLINE_ACTIONS)?,
        ..program::Program::NONE
    };
    let second_state = raw.second_state.as_ref().is_some_and(|second| *second.get_ref());
    let work = work(&image, &place, second_state);
    let watch = check_watch(raw.watch.as_ref())?;
    let allow_force = raw.allow_force.as_ref().is_some_and(|allow| *allow.get_ref());
    let retain = retain::check(raw, around)?;
    let image = bytes.into();
    let path = file.path;
    let program = Program { name, path, place, trust, watch, allow_force, retain, keys, image };
    let retain = raw.retain.as_ref().map(Spanned::span);
    Ok(CheckedProgram { program, span: file.span, retain, work, second_state })
}

/// What may be watched where the file does not say.
const WATCH_DEFAULT: Bytes = Bytes(1 << 10);

fn check_watch(watch: Option<&Spanned<Bytes>>) -> Result<Bytes, Diagnostic> {
    let Some(watch) = watch else { return Ok(WATCH_DEFAULT) };
    let most = Bytes(SAMPLE_BYTES as u64);
    if *watch.get_ref() > most {
        let found = format!("a `watch` of {}", watch.get_ref());
        let allowed = format!("at most {most} of a program in a cycle; \"0KiB\" for none");
        return Err(Diagnostic::new(watch.span(), found, allowed));
    }
    Ok(*watch.get_ref())
}

/// All of an image; of another file, which may have any length, only what shows that.
fn read(mut file: impl Read) -> io::Result<Vec<u8>> {
    let mut bytes = Vec::new();
    file.by_ref().take(takt_program::HEADER_BYTES as u64).read_to_end(&mut bytes)?;
    if bytes.starts_with(&takt_program::MAGIC) {
        file.take(IMAGE_MAX).read_to_end(&mut bytes)?;
    }
    Ok(bytes)
}

fn name_span(raw: &raw::Program) -> Span {
    raw.name.as_ref().unwrap_or(&raw.image).span()
}

fn name<'a>(raw: &'a raw::Program, image: &Image<'a>) -> Result<&'a str, Diagnostic> {
    let text = raw.name.as_ref().map_or(image.name(), |name| name.get_ref());
    check_word(text, name_span(raw)).map_err(|error| match raw.name {
        Some(_) => error,
        None => {
            let found = format!("the program in it is named {}", quote(text));
            let allowed = "1 to 32 of a-z, 0-9 and \"-\", the first of them a letter; the key `name` \
                           gives it such a name";
            Diagnostic::new(raw.image.span(), found, allowed)
        }
    })
}

fn padded(name: &str) -> [u8; program::NAME_BYTES] {
    let mut bytes = [0; program::NAME_BYTES];
    bytes.iter_mut().zip(name.bytes()).for_each(|(to, from)| *to = from);
    bytes
}

/// Compares the key of the signature with those that the file names.
fn check_key(raw: &raw::Program, image: &Image<'_>) -> Result<(Trust, AcceptedKeys), Diagnostic> {
    let Some(keys) = &raw.keys else {
        return Ok((if image.key().is_some() { Trust::NotAsked } else { Trust::Unsigned }, None));
    };
    let texts = keys.get_ref();
    if texts.is_empty() || texts.len() > KEYS_MAX {
        let found = format!("{} keys", texts.len());
        let allowed = format!("1 to {KEYS_MAX} keys; without `keys`, an image needs no signature");
        return Err(Diagnostic::new(keys.span(), found, allowed));
    }
    let accepted = texts.iter().map(parse_key).collect::<Result<Vec<_>, _>>()?;
    let allowed = "an image that is signed with one of these keys";
    match image.key() {
        Some(key) if accepted.contains(&key) => Ok((Trust::Signed(key), Some(accepted))),
        Some(key) => {
            let found = format!("the image is signed with another key, {}", hex(&key));
            Err(Diagnostic::new(raw.image.span(), found, allowed).and(keys.span(), "the keys"))
        }
        None => Err(Diagnostic::new(raw.image.span(), "the image is not signed", allowed)
            .and(keys.span(), "the keys")),
    }
}

fn parse_key(text: &Spanned<String>) -> Result<[u8; 32], Diagnostic> {
    let wrong = || {
        let found = format!("{} is no public key", quote(text.get_ref()));
        let allowed = "64 hexadecimal digits, as `takt plc keygen` prints them";
        Diagnostic::new(text.span(), found, allowed)
    };
    let digits = text.get_ref().as_bytes();
    if digits.len() != 64 || !digits.iter().all(u8::is_ascii_hexdigit) {
        return Err(wrong());
    }
    let mut key = [0; 32];
    for (byte, pair) in key.iter_mut().zip(text.get_ref().as_bytes().chunks(2)) {
        let pair = std::str::from_utf8(pair).ok();
        *byte = pair.and_then(|pair| u8::from_str_radix(pair, 16).ok()).ok_or_else(wrong)?;
    }
    Ok(key)
}

/// A key as people compare it.
pub fn hex(key: &[u8; 32]) -> String {
    key.iter().map(|byte| format!("{byte:02x}")).collect()
}

/// The size of a bank or of the memory for the state: that of the file, or a quarter more than is needed.
fn area(
    key: &str,
    size: Option<&Spanned<Bytes>>,
    needed: u64,
    what: &str,
    image: &Spanned<String>,
) -> Result<u64, Diagnostic> {
    let needed_pages = needed.next_multiple_of(PAGE);
    let Some(size) = size else {
        return Ok((needed + needed / 4).next_multiple_of(STEP));
    };
    let Bytes(bytes) = *size.get_ref();
    if bytes < needed_pages {
        let found = format!("a `{key}` of {} for {what} of {needed} bytes", Bytes(bytes));
        let allowed = format!("at least {}", Bytes(needed_pages));
        return Err(Diagnostic::new(size.span(), found, allowed).and(image.span(), "the image"));
    }
    if !bytes.is_multiple_of(PAGE) || bytes > IMAGE_MAX {
        let found = format!("a `{key}` of {}", Bytes(bytes));
        let allowed = format!("a multiple of {} of at most {}", Bytes(PAGE), Bytes(IMAGE_MAX));
        return Err(Diagnostic::new(size.span(), found, allowed));
    }
    Ok(bytes)
}

/// What the guest needs to run it, apart from banks and state.
fn work(image: &Image<'_>, place: &program::Program, second_state: bool) -> u64 {
    let stacks = image.tasks().map(|task| u64::from(task.stack_bytes));
    let objects = image.objects().map(|object| match object.kind {
        ObjectKind::Queue { message_bytes, depth } => program::queue_bytes(message_bytes, depth),
        ObjectKind::Mailbox { bytes } => program::mailbox_bytes(bytes),
        ObjectKind::Semaphore { .. } | ObjectKind::Flags => 0,
    });
    // Each object's messages have pages of their own.
    let objects = objects.map(|bytes| bytes.next_multiple_of(PAGE));
    // The kernel closes both banks to itself page by page, with a table for each part of 2 MiB, of which a bank may
    // begin and end in the middle. The program sees both banks and its states by tables of its own; the first of each bank and
    // of the first state is among what each program has.
    let closed = 2 * (place.bank_bytes / TABLE + 2);
    let seen = 2 * (place.bank_bytes / TABLE) + place.state_bytes / TABLE;
    let second = if second_state { place.state_bytes / TABLE + 1 } else { 0 };
    let tables = (closed + seen + second) * PAGE;
    let area = |area| image.area_bytes(area);
    let views =
        image.tasks().len() as u64 * program::view_bytes(area(Area::Input), area(Area::Output));
    // Bounded by the limits of an image: 16 views of 193 KiB, 16 stacks of 1 MiB, 64 queues of 4 MiB.
    const { assert!(limit::TASKS <= 16 && limit::OBJECTS <= 64) };
    let bytes =
        program::WORK_BYTES_EACH + tables + views + stacks.sum::<u64>() + objects.sum::<u64>();
    bytes.next_multiple_of(PAGE)
}

type Action = (&'static str, u32);
const LOG: Action = ("log", action::LOG);
const SKIP: Action = ("skip", action::SKIP);
const STOP: Action = ("stop", action::STOP_PROGRAM);
const WARM_RESTART: Action = ("warm-restart", action::WARM_RESTART_PROGRAM);
const RESTART: Action = ("restart", action::RESTART_PROGRAM);
const STOP_PARTITION: Action = ("stop-partition", action::STOP_PARTITION);

/// What may follow from each error, that of a file without the key first.
const FAULT_ACTIONS: [Action; 4] = [STOP, WARM_RESTART, RESTART, STOP_PARTITION];
const OVERRUN_ACTIONS: [Action; 6] = [SKIP, LOG, STOP, WARM_RESTART, RESTART, STOP_PARTITION];
const DEADLINE_ACTIONS: [Action; 6] = [LOG, SKIP, STOP, WARM_RESTART, RESTART, STOP_PARTITION];

fn check_action(
    key: &str,
    value: Option<&Spanned<String>>,
    allowed: &[Action],
) -> Result<u32, Diagnostic> {
    let wanted = value.map_or(allowed[0].0, |value| value.get_ref());
    if let Some((_, number)) = allowed.iter().find(|(name, _)| *name == wanted) {
        return Ok(*number);
    }
    let names: Vec<String> = allowed.iter().map(|(name, _)| quote(name)).collect();
    let found = format!("there is no action {} for `{key}`", quote(wanted));
    Err(Diagnostic::new(value.map_or(0..0, Spanned::span), found, names.join(", ")))
}

/// The name of an action, as in the file.
pub fn action_name(number: u32) -> &'static str {
    OVERRUN_ACTIONS.iter().find(|(_, n)| *n == number).map_or("-", |(name, _)| name)
}
