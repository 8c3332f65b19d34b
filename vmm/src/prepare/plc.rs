//! A PLC's partition: memory, machine, image and tables.

use std::path::Path;

use kvm_ioctls::VcpuFd;
use takt_abi::PortTable;
use takt_abi::memory::PORT_TABLE;
use takt_devices::output;

use super::crew::Crew;
use super::spawn::{Processor, Seat};
use super::{Preparation, Prepared};
use crate::boot::StartMode;
use crate::boot::long_mode::{self, StartError};
use crate::boot::plc::{PlcImage, Source};
use crate::boot::programs::Programs;
use crate::boot::touch::{TouchError, touch};
use crate::config::Partition;
use crate::doorbell;
use crate::interrupts::apic;
use crate::live::Banks;
use crate::machine::{self, MachineError};
use crate::memory::GuestMemory;
use crate::passthrough::Granted;
use crate::restart::{PlcLoader, Restart};
use crate::run_error::RunError;
use crate::vcpu::first_state::FirstState;
use crate::vcpu::plc::PlcGuest;

impl Preparation<'_> {
    pub(super) fn plc(
        &mut self,
        partition: &Partition,
        image: Option<&Path>,
    ) -> Result<Prepared, RunError> {
        let unfit = |source| RunError::Plc { partition: partition.name().to_owned(), source };
        let bytes = partition.memory_bytes();
        let ports = self.channels.of(partition.id(), partition.kind());
        let programs = Programs::of(partition);
        let source = match (image, &programs) {
            (Some(path), _) => Source::File(path),
            (None, Some(_)) => Source::Kernel,
            (None, None) => Source::Demo,
        };
        let image = PlcImage::read(source, bytes).map_err(unfit)?;
        let pages = self.pages_of(partition);
        let memory = self.clear(|| match &programs {
            None => GuestMemory::for_plc(bytes, pages, &ports.views),
            Some(_) => GuestMemory::for_plc_with_programs(bytes, pages, &ports.views),
        })?;
        let devices = self.devices.of(partition.id()).cloned();
        let interrupts = devices.as_ref().is_some_and(Granted::interrupts);
        let machine = machine::for_plc(&self.kvm, &memory, interrupts)?;
        let processor = FirstState::of(&self.kvm, &machine.vcpu)?;
        if let Some(devices) = &devices {
            devices.map_into(&machine.vm)?;
        }
        let entry = image.load(&memory).map_err(unfit)?;
        if let Some(programs) = &programs {
            let beginnings = (0..partition.programs().len())
                .filter_map(|place| Some((place, self.retained.beginning(partition, place)?)));
            for (place, beginning) in beginnings {
                beginning.kept.iter().for_each(|kept| programs.keep(place, kept.clone()));
            }
            // What outlives a stop of Takt is not lost by its start.
            let table = programs.load(&memory, StartMode::Warm)?;
            let mut page = memory
                .program_table()
                .ok_or(MachineError::Missing("the PLC guest's program table"))?;
            page.write(table);
            let mut io =
                memory.io_table().ok_or(MachineError::Missing("the PLC guest's I/O table"))?;
            io.write(partition.io_table());
        }
        let mut table = memory
            .port_table(PORT_TABLE)
            .ok_or(MachineError::Missing("the PLC guest's port table"))?;
        let tsc = *self.frequency.get_or_insert(machine.tsc);
        table.write(PortTable { tsc_khz: tsc.khz().into(), ..ports.table });
        for region in &ports.own {
            region.format(&memory)?;
        }
        for (port, listener) in &ports.rings {
            let linux = self.linuxes.get(listener);
            let bell = &linux.ok_or(MachineError::Missing("a Linux's doorbell"))?.doorbell;
            doorbell::attach_source(&machine.vm, *port, bell)?;
        }
        long_mode::write_tables(memory.regions()).map_err(StartError::from)?;
        let lines = devices.as_ref().map_or(&[][..], |devices| &devices.lines);
        self.interrupts.attach(partition.name(), machine.vm, lines)?;
        let space = devices.as_ref().and_then(|devices| devices.space.clone());
        let safe_values = devices.as_ref().map(|devices| devices.safe_values.clone());
        let safe_values = safe_values.unwrap_or_default();
        if let Some(space) = &space {
            space.start(&memory)?;
        }
        let (console, output) = output::dropping();
        let frame = self.file.schedules().frame();
        let guest = PlcGuest::new(&memory, bytes, tsc.khz(), frame, console)
            .ok_or(MachineError::Missing("the PLC guest's pages"))?
            .with_devices(devices);
        let banks = programs.clone().map(|programs| Banks { memory: memory.clone(), programs });
        let loader = PlcLoader {
            memory: memory.clone(),
            image,
            programs,
            channels: ports.own,
            space,
            safe_values,
            processor,
            apic_keys: machine.apic_keys,
        };
        let (restart, revivals) = Restart::new(loader, self.spawner)?;
        let touched = memory.clone();
        let ready = move |vcpu: &mut VcpuFd| -> Result<(), TouchError> {
            touch(vcpu, &touched)?;
            long_mode::set_registers(vcpu, entry)?;
            if interrupts {
                apic::reset(vcpu).map_err(StartError::from)?;
            }
            Ok(())
        };
        let (seat, crew) = (Seat::new(partition), Crew::default());
        let processor = Processor { vcpu: machine.vcpu, ready, seat, crew };
        let mut prepared = self.spawn(partition, processor, memory, guest, output, revivals)?;
        prepared.account.can_restart(restart);
        prepared.account.banks = banks;
        Ok(prepared)
    }
}
