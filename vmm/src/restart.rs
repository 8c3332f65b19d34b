//! Starting a PLC guest anew.
//!
//! Clearing and loading memory takes longer than a window. It is therefore done by the event
//! thread, while the partition's own thread waits and uses none of its windows; the others do not
//! notice. Only then the thread gets the word to reset its processor and go on.

use std::sync::mpsc::{Receiver, Sender, channel};

use crate::boot::StartMode;
use crate::boot::long_mode::Entry;
use crate::boot::plc::PlcImage;
use crate::channels::OwnRegion;
use crate::memory::GuestMemory;
use crate::run_error::RunError;

/// The word to a partition's thread that its guest has been loaded.
#[derive(Clone, Copy, Debug)]
pub struct Revival {
    /// How.
    pub mode: StartMode,
    /// Where it starts.
    pub entry: Entry,
}

/// What is needed to start a guest anew. When it is dropped, the thread that waits for it ends.
pub struct Restart {
    memory: GuestMemory,
    image: PlcImage,
    /// What the guest may have damaged and needs to be whole.
    channels: Vec<OwnRegion>,
    thread: Sender<Revival>,
}

impl Restart {
    /// For the guest of `image` in `memory`; the other part is for its thread.
    #[must_use]
    pub fn new(
        memory: GuestMemory,
        image: PlcImage,
        channels: Vec<OwnRegion>,
    ) -> (Self, Receiver<Revival>) {
        let (thread, revivals) = channel();
        (Self { memory, image, channels, thread }, revivals)
    }

    /// Loads the guest and lets its thread go on. The thread must have told of its end.
    ///
    /// # Errors
    /// If the image cannot be loaded, or a channel not prepared: neither happens for the first
    /// time then.
    pub fn start(&self, mode: StartMode) -> Result<(), RunError> {
        let entry = self.image.reload(&self.memory, mode).map_err(RunError::Reload)?;
        for region in &self.channels {
            region.format(&self.memory)?;
        }
        // A thread that is gone has told of that too.
        let _ = self.thread.send(Revival { mode, entry });
        Ok(())
    }
}
