//! A PLC, in its own machine.

use std::sync::Arc;

use super::{LoadError, Loader, Revival};
use crate::apic_keys::ApicKeys;
use crate::boot::Start;
use crate::boot::long_mode::{self, StartError};
use crate::boot::plc::PlcImage;
use crate::boot::programs::Programs;
use crate::channels::OwnRegion;
use crate::handoff::Giver;
use crate::interrupts::apic;
use crate::life::Starts;
use crate::memory::GuestMemory;
use crate::passthrough::safe_values::SafeValues;
use crate::passthrough::vfio::Space;
use crate::sandbox::Kind;
use crate::vcpu::first_state::FirstState;
use crate::vcpu::kick::Kickable;
use crate::vcpu::plc::PlcGuest;

/// What loads a PLC anew.
pub struct PlcLoader {
    /// What may still write to the memory when the guest has ended: it goes before the memory does.
    pub space: Option<Arc<Space>>,
    /// All of it.
    pub memory: GuestMemory,
    /// What is loaded.
    pub image: PlcImage,
    /// What the image runs.
    pub programs: Option<Programs>,
    /// What the guest may have damaged and needs to be whole.
    pub channels: Vec<OwnRegion>,
    /// What its outputs are until it drives them again.
    pub safe_values: SafeValues,
    /// What the guest may have changed in the processor.
    pub processor: FirstState,
    /// Held as long as the guest can switch an APIC, if it has one.
    pub apic_keys: Option<ApicKeys>,
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
            let stopped = space.stop();
            // A reset has set them to what they are after power-on, also where that of another function fails.
            self.safe_values.write_registers();
            stopped?;
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

#[cfg(test)]
mod tests {
    use std::fs::File;
    use std::io::Read;
    use std::os::fd::FromRawFd;
    use std::os::unix::fs::FileExt;

    use super::*;
    use crate::boot::plc::Source;
    use crate::boot::{StartMode, StartReason};
    use crate::handoff::handoff;
    use crate::memory::Pages;
    use crate::passthrough::mapping::Mapping;
    use crate::passthrough::safe_values::{Target, Write};
    use crate::passthrough::vfio::device::Device;
    use crate::vcpu::port_access::Width;

    const RAM: u64 = 4 << 20;

    fn file() -> File {
        // SAFETY: the name is a literal; the descriptor is new.
        let file =
            unsafe { File::from_raw_fd(libc::memfd_create(c"c".as_ptr(), libc::MFD_CLOEXEC)) };
        file.set_len(4096).unwrap();
        file
    }

    /// What is in the first register of a card after its partition was loaded anew, or was to be. It has this
    /// configuration space, if it is confined.
    fn register_after_a_start(configuration: Option<File>) -> (bool, u32) {
        let mut card = file();
        let memory = Arc::new(Mapping::new(&card, 0, 4096).unwrap());
        let target = Target::Register(memory, 0);
        let safe_values = SafeValues::new(vec![Write { target, width: Width::Four, value: 7 }]);
        let space =
            |configuration| Space::of_device(Device::of_file(configuration, 0, false), file());
        let mut loader = PlcLoader {
            memory: GuestMemory::for_plc(RAM, Pages::Small, &[]).unwrap(),
            image: PlcImage::read(Source::Demo, RAM).unwrap(),
            programs: None,
            channels: Vec::new(),
            space: configuration.map(space).map(Arc::new),
            safe_values,
            processor: FirstState::none(),
            apic_keys: None,
        };
        let start = Start { mode: StartMode::Cold, reason: StartReason::Operator };
        let loaded = loader.load(start, &mut handoff(1).0).is_ok();
        let mut bytes = [0; 4];
        card.read_exact(&mut bytes).unwrap();
        (loaded, u32::from_le_bytes(bytes))
    }

    #[test]
    fn safe_values_are_written_again_after_a_reset() {
        let configuration = file();
        configuration.write_all_at(&[0; 64], 0).unwrap();
        assert_eq!(register_after_a_start(Some(configuration)), (true, 7));
        assert_eq!(register_after_a_start(None), (true, 0), "nothing has been reset");
    }

    #[test]
    fn safe_values_are_written_again_though_a_function_cannot_be_stopped() {
        let gone = file();
        gone.set_len(0).unwrap();
        assert_eq!(register_after_a_start(Some(gone)), (false, 7));
    }
}
