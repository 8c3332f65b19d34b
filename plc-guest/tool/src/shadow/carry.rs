//! The state of one version as that of another, as the kernel's commit makes it.

use takt_change::cost::{GATHER_BYTES, SAVED_BYTES};
use takt_change::{LargePlan, Memory, Plan, Ready, Room, TwoStates, is_to_second};
use takt_program::Image;

/// The state of `new` that follows from that of `old` by this plan.
pub fn carried(plan: &[u8], old: &Image<'_>, new: &Image<'_>, state: &[u8]) -> Vec<u8> {
    if is_to_second(plan) {
        return in_a_second_state(plan, old, new, state);
    }
    let bytes = old.state_bytes().max(new.state_bytes()) as usize;
    let mut memory = Rooms {
        state: state.to_vec(),
        initial: new.state().to_vec(),
        gathered: vec![0; GATHER_BYTES as usize],
        saved: vec![0; SAVED_BYTES as usize],
    };
    memory.state.resize(bytes, 0);
    memory.initial.resize(bytes, 0);
    // The plan was made from these images a moment ago.
    if let Ok(plan) = Plan::parse(plan, old, new) {
        let ready = Ready::new(plan);
        ready.prepare(0, u64::MAX, &mut memory);
        ready.apply(&mut memory);
    }
    memory.state.truncate(new.state_bytes() as usize);
    memory.state
}

fn in_a_second_state(plan: &[u8], old: &Image<'_>, new: &Image<'_>, state: &[u8]) -> Vec<u8> {
    let mut second = new.state().to_vec();
    second.resize(new.state_bytes() as usize, 0);
    let mut states = States { old: state, new: second };
    if let Ok(plan) = LargePlan::parse(plan, old, new) {
        for number in 0..plan.pages() {
            let mut page = plan.page(number);
            while !plan.carry(&mut page, u64::MAX, &mut states) {}
        }
    }
    states.new
}

struct States<'a> {
    old: &'a [u8],
    new: Vec<u8>,
}

impl States<'_> {
    fn bytes(&self, from: u32, bytes: u32) -> &[u8] {
        self.old
            .get(from as usize..)
            .and_then(|rest| rest.get(..bytes as usize))
            .unwrap_or_default()
    }

    fn put(&mut self, to: u32, bytes: &[u8]) {
        let place = self.new.get_mut(to as usize..);
        if let Some(place) = place.and_then(|rest| rest.get_mut(..bytes.len())) {
            place.copy_from_slice(bytes);
        }
    }
}

impl TwoStates for States<'_> {
    fn copy(&mut self, from: u32, to: u32, bytes: u32) {
        let moved = self.bytes(from, bytes).to_vec();
        self.put(to, &moved);
    }

    fn number(&self, from: u32, bytes: u32) -> u64 {
        let found = self.bytes(from, bytes);
        found.iter().rev().fold(0, |number, byte| number << 8 | u64::from(*byte))
    }

    fn set_number(&mut self, to: u32, bytes: u32, value: u64) {
        self.put(to, value.to_le_bytes().get(..bytes as usize).unwrap_or_default());
    }

    fn lost(&mut self, _: u32) {}
}

struct Rooms {
    state: Vec<u8>,
    initial: Vec<u8>,
    gathered: Vec<u8>,
    saved: Vec<u8>,
}

impl Rooms {
    fn bytes(&self, room: Room, bytes: u32) -> Option<&[u8]> {
        let (room, at) = match room {
            Room::State(at) => (&self.state, at),
            Room::Initial(at) => (&self.initial, at),
            Room::Gathered(at) => (&self.gathered, at),
            Room::Saved(at) => (&self.saved, at),
        };
        room.get(at as usize..at as usize + bytes as usize)
    }

    fn put(&mut self, room: Room, bytes: &[u8]) {
        let (room, at) = match room {
            Room::State(at) => (&mut self.state, at),
            Room::Initial(at) => (&mut self.initial, at),
            Room::Gathered(at) => (&mut self.gathered, at),
            Room::Saved(at) => (&mut self.saved, at),
        };
        if let Some(to) = room.get_mut(at as usize..at as usize + bytes.len()) {
            to.copy_from_slice(bytes);
        }
    }
}

impl Memory for Rooms {
    fn copy(&mut self, from: Room, to: Room, bytes: u32) {
        let moved = self.bytes(from, bytes).unwrap_or_default().to_vec();
        self.put(to, &moved);
    }

    fn number(&self, at: Room, bytes: u32) -> u64 {
        let found = self.bytes(at, bytes).unwrap_or_default();
        found.iter().rev().fold(0, |number, byte| number << 8 | u64::from(*byte))
    }

    fn set_number(&mut self, at: Room, bytes: u32, value: u64) {
        self.put(at, value.to_le_bytes().get(..bytes as usize).unwrap_or_default());
    }
}
