//! A PLC, in its own machine.

use std::sync::Arc;

use super::{LoadError, Loader, Revival};
use crate::boot::Start;
use crate::boot::long_mode::{self, StartError};
use crate::boot::plc::PlcImage;
use crate::boot::programs::Programs;
use crate::channels::OwnRegion;
use crate::handoff::Giver;
use crate::interrupts::apic;
use crate::life::Starts;
use crate::memory::GuestMemory;
use crate::passthrough::vfio::Space;
use crate::sandbox::Kind;
use crate::vcpu::first_state::FirstState;
use crate::vcpu::kick::Kickable;
use crate::vcpu::plc::PlcGuest;

/// What loads a PLC anew.
pub struct PlcLoader {
    /// All of it.
    pub memory: GuestMemory,
    /// What is loaded.
    pub image: PlcImage,
    /// What the image runs.
    pub programs: Option<Programs>,
    /// What the guest may have damaged and needs to be whole.
    pub channels: Vec<OwnRegion>,
    /// What may still write to the memory when the guest has ended.
    pub space: Option<Arc<Space>>,
    /// What the guest may have changed in the processor.
    pub processor: FirstState,
}

impl Loader for PlcLoader {
    type Guest = PlcGuest;
    const THREAD: (&str, Kind) = ("plc-loader", Kind::PlcLoader);
    const STARTS: Starts = Starts::ColdAndWarm;

    fn load(
        &mut self,
        start: Start,
        thread: &mut Giver<Revival<PlcGuest>>,
    ) -> Result<(), LoadError> {
        if let Some(space) = &self.space {
            space.stop()?;
        }
        if let Some(programs) = &self.programs {
            programs.begin_start();
        }
        let entry = self.image.reload(&self.memory, start.mode)?;
        if let Some(programs) = &self.programs {
            let table = programs.load(&self.memory, start.mode)?;
            if let Some(mut page) = self.memory.program_table() {
                page.write(table);
            }
        }
        for region in &self.channels {
            region.format(&self.memory)?;
        }
        long_mode::write_tables(self.memory.regions()).map_err(StartError::from)?;
        if let Some(space) = &self.space {
            space.resume()?;
        }
        let mut processor = self.processor.clone();
        let revival = move |kickable: &mut Kickable, guest: &mut PlcGuest| {
            guest.start_anew(start);
            // What the last exit has left to be done must not happen to the new guest.
            kickable.prime().is_ok()
                && processor.restore(kickable.vcpu()).is_ok()
                && long_mode::set_registers(kickable.vcpu(), entry).is_ok()
                && (!guest.has_interrupts() || apic::reset(kickable.vcpu()).is_ok())
        };
        // A thread that is gone has told of that too.
        let _ = thread.give(Box::new(revival));
        Ok(())
    }
}
