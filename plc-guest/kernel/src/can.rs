//! CAN objects: what programs receive and send by the controllers of the partition.
//!
//! An object is a value and no queue: a program sees the newest frame, and of an output that the bus has no room for the
//! newest value is sent. Nothing here waits. A controller is polled, each step is a bounded number of accesses to it, and
//! whatever it answers becomes a figure.
//!
//! A controller has one transmit buffer. Objects that find it busy wait, and take turns, so each of them comes.

use crate::process_image::Newest;
use crate::time::Clock;
use takt_abi::can::{
    CONTROLLERS_MAX, Controller as Settings, DATA_MAX, EXTENDED, OBJECTS_MAX, ON_CHANGE, Object,
};
use takt_abi::io::{INPUT, OUTPUT};
use takt_sja1000::{
    BitRate, BusState, Controller, ExtendedId, Filter, Frame, Id, ReceiveError, Registers,
    StandardId, StartError, TransmitError,
};

/// What became of the frames of a controller.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Figures {
    /// Frames of objects that were taken.
    pub received: u64,
    /// Frames that were handed over.
    pub sent: u64,
    /// Frames of no object, and remote frames.
    pub foreign: u64,
    /// Frames of an object with too few bytes.
    pub short: u64,
    /// Values that gave way to newer ones while they waited.
    pub replaced: u64,
    /// Times that the controller was found off its bus.
    pub bus_offs: u64,
}

/// A controller that has started.
#[derive(Debug)]
struct Bus<R> {
    driver: Controller<R>,
    frames: u8,
    figures: Figures,
    /// The object that was handed over last.
    last: usize,
    /// Since when it is off its bus, or when it was last told to come back.
    off: Option<u64>,
}

impl<R: Registers> Bus<R> {
    /// A controller that goes off its bus was disturbing it, or was disturbed. After a while it is told to come back.
    fn is_off(&mut self, now: u64, patience: u64) {
        match self.off {
            None => self.figures.bus_offs += 1,
            Some(since) if now.saturating_sub(since) < patience => return,
            Some(_) => self.driver.request_recovery(),
        }
        self.off = Some(now);
    }
}

/// What an object has.
#[derive(Clone, Copy, Debug)]
struct State {
    data: [u8; DATA_MAX],
    /// When it was received, or written; none before.
    stamp: Option<u64>,
    count: u32,
    /// It is to be sent.
    waits: bool,
}

/// The controllers of a partition and the objects of its programs.
#[derive(Debug)]
pub struct Can<R> {
    buses: [Option<Bus<R>>; CONTROLLERS_MAX],
    objects: [Object; OBJECTS_MAX],
    states: [State; OBJECTS_MAX],
    /// How long a controller stays off its bus, in ticks.
    patience: u64,
}

impl<R: Registers> Can<R> {
    /// Without any.
    pub const NONE: Self = Self {
        buses: [const { None }; CONTROLLERS_MAX],
        objects: [Object::NONE; OBJECTS_MAX],
        states: [State { data: [0; DATA_MAX], stamp: None, count: 0, waits: false }; OBJECTS_MAX],
        patience: 0,
    };

    /// With these objects, and no controller that has started. One that is off its bus is told to come back after so many
    /// ticks.
    pub fn new(objects: &[Object; OBJECTS_MAX], patience: u64) -> Self {
        Self { objects: *objects, patience, ..Self::NONE }
    }

    /// Starts a controller. Without one that starts its objects are never received, and never sent.
    ///
    /// # Errors
    /// [`StartError`]: it is not there, or behaves like none.
    pub fn start(
        &mut self,
        number: usize,
        settings: &Settings,
        registers: R,
    ) -> Result<(), StartError> {
        let rate = BitRate::from_kbit_per_s(settings.kbit_per_s).ok_or(StartError::Absent)?;
        let received = self.objects.iter().filter(|o| is_of(o, number, INPUT)).filter_map(id);
        let driver = Controller::start(registers, rate, Filter::for_all(received))?;
        if let Some(bus) = self.buses.get_mut(number) {
            let (frames, figures) = (settings.frames, Figures::default());
            *bus = Some(Bus { driver, frames, figures, last: 0, off: None });
        }
        Ok(())
    }

    /// The controller of an object.
    pub fn controller(&self, object: u64) -> usize {
        let object = usize::try_from(object).ok().and_then(|at| self.objects.get(at));
        object.map_or(0, |object| object.controller.into())
    }

    /// Takes what a controller has received, at most as many frames as the partition file allows a job. False if the time
    /// `is_over` before that, which is looked at before each frame: what is left stays in the controller.
    pub fn receive(&mut self, number: usize, now: u64, is_over: impl Fn() -> bool) -> bool {
        let Some(bus) = self.buses.get_mut(number).and_then(Option::as_mut) else { return true };
        for _ in 0..bus.frames {
            if is_over() {
                return false;
            }
            let frame = match bus.driver.receive() {
                Ok(frame) => frame,
                Err(ReceiveError::Empty) => break,
                Err(ReceiveError::BusOff) => {
                    bus.is_off(now, self.patience);
                    return true;
                }
            };
            let wanted = |object: &Object| {
                is_of(object, number, INPUT) && id(object) == Some(frame.id()) && !frame.is_remote()
            };
            let Some(at) = self.objects.iter().position(wanted) else {
                bus.figures.foreign += 1;
                continue;
            };
            if frame.length() < self.objects[at].bytes {
                bus.figures.short += 1;
                continue;
            }
            bus.figures.received += 1;
            let state = &mut self.states[at];
            state.data = [0; DATA_MAX];
            state.data.iter_mut().zip(frame.bytes()).for_each(|(to, from)| *to = *from);
            (state.stamp, state.count) = (Some(now), state.count.wrapping_add(1));
        }
        self.is_on(number);
        true
    }

    /// A controller answers as one on its bus. If it was off, the frame in its buffer is lost: all is sent anew.
    fn is_on(&mut self, number: usize) {
        let Some(bus) = self.buses.get_mut(number).and_then(Option::as_mut) else { return };
        if bus.off.take().is_some() {
            for (object, state) in self.objects.iter().zip(&mut self.states) {
                state.waits |= is_of(object, number, OUTPUT) && state.stamp.is_some();
            }
        }
    }

    /// What an object has received.
    pub fn newest(&self, object: u64, now: u64, clock: &Clock) -> Newest<'_> {
        let state = usize::try_from(object).ok().and_then(|at| self.states.get(at));
        let Some((state, stamp)) = state.and_then(|state| Some((state, state.stamp?))) else {
            return Newest::NONE;
        };
        Newest {
            message: Some(&state.data),
            valid: true,
            age: clock.span(now.saturating_sub(stamp)).0,
            count: state.count,
        }
    }

    /// Gives an object the data that `fill` makes of zeros. It waits to be sent, unless that is for changes only and this
    /// is none.
    pub fn put(&mut self, object: u64, now: u64, fill: impl FnOnce(&mut [u8])) {
        let Ok(at) = usize::try_from(object) else { return };
        let (Some(object), Some(state)) = (self.objects.get(at), self.states.get_mut(at)) else {
            return;
        };
        let mut data = [0; DATA_MAX];
        fill(&mut data);
        let same = state.stamp.is_some() && state.data == data;
        if same && object.flags & ON_CHANGE != 0 {
            return;
        }
        if let Some(Some(bus)) = self.buses.get_mut(usize::from(object.controller)) {
            bus.figures.replaced += u64::from(state.waits);
        }
        (state.data, state.stamp, state.waits) = (data, Some(now), true);
    }

    /// True if an object of a controller waits to be sent.
    pub fn waits(&self, number: usize) -> bool {
        let mut all = self.objects.iter().zip(&self.states);
        matches!(self.buses.get(number), Some(Some(_)))
            && all.any(|(object, state)| is_of(object, number, OUTPUT) && state.waits)
    }

    /// Hands objects that wait over to a controller: as many as it takes, at most as many as the partition file allows a
    /// job, and none when the time `is_over`. The others wait still.
    pub fn send(&mut self, number: usize, now: u64, is_over: impl Fn() -> bool) {
        let frames = self.buses.get(number).and_then(Option::as_ref).map_or(0, |bus| bus.frames);
        for _ in 0..frames {
            if is_over() || !self.send_one(number, now) {
                return;
            }
        }
    }

    /// Hands one object over; false if none waits, or the controller takes none.
    pub fn send_one(&mut self, number: usize, now: u64) -> bool {
        let Some(bus) = self.buses.get_mut(number).and_then(Option::as_mut) else { return false };
        let turns = (bus.last + 1..OBJECTS_MAX).chain(0..=bus.last.min(OBJECTS_MAX - 1));
        let mut waiting =
            turns.filter(|at| is_of(&self.objects[*at], number, OUTPUT) && self.states[*at].waits);
        let Some(at) = waiting.next() else { return false };
        let (object, state) = (&self.objects[at], &mut self.states[at]);
        let bytes = state.data.get(..object.bytes.into()).unwrap_or_default();
        let frame = id(object).and_then(|id| Frame::data(id, bytes).ok());
        match frame.map(|frame| bus.driver.transmit(&frame)) {
            Some(Err(TransmitError::BusOff)) => {
                bus.is_off(now, self.patience);
                return false;
            }
            Some(Err(TransmitError::Busy)) => {
                self.is_on(number);
                return false;
            }
            Some(Ok(())) => bus.figures.sent += 1,
            // The partition file has no such object.
            None => {}
        }
        (bus.last, state.waits) = (at, false);
        // It may be the first sign that the controller is back, and then it is sent with the others.
        self.is_on(number);
        true
    }

    /// The part that a controller takes in its bus, what became of its frames, and how often it had no room for one. 4
    /// accesses.
    pub fn look(&mut self, number: usize, now: u64) -> Option<(BusState, Figures, u64)> {
        let bus = self.buses.get_mut(number)?.as_mut()?;
        let state = bus.driver.state();
        if state == BusState::BusOff {
            bus.is_off(now, self.patience);
        }
        Some((state, bus.figures, bus.driver.overruns()))
    }
}

fn is_of(object: &Object, number: usize, direction: u8) -> bool {
    object.direction == direction && usize::from(object.controller) == number
}

fn id(object: &Object) -> Option<Id> {
    let number = object.identifier & !EXTENDED;
    if object.identifier & EXTENDED != 0 {
        return ExtendedId::new(number).ok().map(Id::from);
    }
    u16::try_from(number).ok().and_then(|id| StandardId::new(id).ok()).map(Id::from)
}
