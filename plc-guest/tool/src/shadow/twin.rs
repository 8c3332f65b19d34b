//! A version of a program that computes here what it would in the PLC.

use std::time::Duration;

use takt_program::{Area, Image, address};
use takt_protocol as protocol;

use crate::run::{Failed, HostError, Machine, Schedule};

/// Bytes of a range at most.
const RANGE_BYTES: u32 = 1 << 15;

/// The memory of a program that counts from one cycle to the next.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Watched {
    pub state: Vec<u8>,
    pub inputs: Vec<u8>,
    pub outputs: Vec<u8>,
    pub markers: Vec<u8>,
}

/// The areas of [`Watched`], in its order.
const AREAS: [protocol::Area; 4] =
    [protocol::Area::State, protocol::Area::Input, protocol::Area::Output, protocol::Area::Marker];

/// The bytes of these areas.
fn lengths(image: &Image<'_>) -> [u32; 4] {
    let area = |area| image.area_bytes(area);
    [image.state_bytes(), area(Area::Input), area(Area::Output), area(Area::Marker)]
}

impl Watched {
    /// What is to be watched of a program at this place in its partition.
    pub fn ranges(image: &Image<'_>, place: u8) -> Vec<protocol::Range> {
        let mut ranges = Vec::new();
        for (area, length) in AREAS.into_iter().zip(lengths(image)) {
            for offset in (0..length).step_by(RANGE_BYTES as usize) {
                // At most 2^15, which fits.
                let bytes = (length - offset).min(RANGE_BYTES) as u16;
                ranges.push(protocol::Range { program: place, area, offset, bytes });
            }
        }
        ranges
    }

    /// From the bytes of these ranges.
    pub fn from_bytes(image: &Image<'_>, bytes: &[u8]) -> Option<Self> {
        let mut rest = bytes;
        let mut areas = [const { Vec::new() }; 4];
        for (to, length) in areas.iter_mut().zip(lengths(image)) {
            let (area, more) = rest.split_at_checked(length as usize)?;
            *to = area.to_vec();
            rest = more;
        }
        let [state, inputs, outputs, markers] = areas;
        rest.is_empty().then_some(Self { state, inputs, outputs, markers })
    }
}

/// See the module.
pub struct Twin<'a> {
    image: Image<'a>,
    machine: Machine<'a>,
    schedule: Schedule<'a>,
}

impl<'a> Twin<'a> {
    /// A version whose jobs may take so long here.
    pub fn new(image: Image<'a>, limit: Duration) -> Result<Self, HostError> {
        let (machine, schedule) = (Machine::new(image, limit)?, Schedule::new(&image));
        Ok(Self { image, machine, schedule })
    }

    /// Puts it where a program is that was watched.
    pub fn set(&self, watched: &Watched) {
        self.machine.put(address::STATE, &watched.state);
        self.machine.put(address::INPUT, &watched.inputs);
        self.machine.put(address::OUTPUT, &watched.outputs);
        self.machine.put(address::MARKER, &watched.markers);
    }

    /// Jobs that were released before this time of the program are done.
    pub fn begin(&mut self, time_ns: u64) {
        self.schedule = Schedule::at(&self.image, time_ns, &self.machine);
    }

    /// Runs the jobs that are released in this time, with these inputs.
    pub fn run(&mut self, inputs: &[u8], nanoseconds: u64) -> Result<(), Failed> {
        self.machine.put(address::INPUT, inputs);
        self.schedule.step(&mut self.machine, nanoseconds, &mut Vec::new())
    }

    pub fn outputs(&self) -> Vec<u8> {
        self.bytes(address::OUTPUT, self.image.area_bytes(Area::Output))
    }

    /// What could be watched of it.
    pub fn watched(&self) -> Watched {
        let [state, inputs, outputs, markers] = lengths(&self.image);
        Watched {
            state: self.bytes(address::STATE, state),
            inputs: self.bytes(address::INPUT, inputs),
            outputs: self.bytes(address::OUTPUT, outputs),
            markers: self.bytes(address::MARKER, markers),
        }
    }

    fn bytes(&self, at: u64, bytes: u32) -> Vec<u8> {
        self.machine.get(at, bytes.into()).unwrap_or_default()
    }
}
