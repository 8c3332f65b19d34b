//! What a partition file says of the host's devices, and what `takt check` shows of it.

use std::fs;
use std::path::Path;

use takt_plan::check;
use takt_plan::{self as config, InterruptSource, MemorySource, PartitionFile, SafePlace};

fn file() -> PartitionFile {
    load("good/passthrough.toml")
}

fn load(name: &str) -> PartitionFile {
    let path = Path::new("tests/partition_files").join(name);
    config::load(&path, None).unwrap_or_else(|error| panic!("{error}"))
}

#[test]
fn a_good_file_says_what_each_partition_gets() {
    let file = file();
    let [plc, other] = file.partitions() else { panic!() };
    let it = plc.passthrough();
    let ports: Vec<(u16, u16)> = it.ports.iter().map(|p| (p.first, p.last)).collect();
    assert_eq!(ports, [(0x378, 0x37a), (0x2000, 0x207f)]);
    assert_eq!(it.ports[0].bar, None);
    let bar = it.ports[1].bar.as_ref().unwrap();
    assert_eq!((bar.function.name(), bar.bar), ("0000:00:10.0", 1));
    assert!(bar.unbind && bar.vfio && !bar.trusted_dma);
    let [card, timer, coupler] = &it.memory[..] else { panic!() };
    assert!(
        matches!(&card.source, MemorySource::Pci(bar) if bar.trusted_dma && !bar.vfio && !bar.unbind)
    );
    assert_eq!(
        timer.source,
        MemorySource::Physical { address: 0xfed0_0000, shared_with_host: true }
    );
    assert_eq!((coupler.address, coupler.bytes), (0xd000_2000, 0x2000));
    assert_eq!(coupler.source, MemorySource::Uio { device: "uio0".into(), map: 1 });
    let [first, last] = &it.interrupts[..] else { panic!() };
    assert_eq!((first.vector, last.vector), (32, 254));
    assert!(matches!(&first.source, InterruptSource::Pci(pci) if pci.name() == "0000:00:06.0"));
    assert_eq!(last.source, InterruptSource::Uio("uio0".into()));
    let values: Vec<_> =
        it.safe_values.iter().map(|s| (s.place.clone(), s.width, s.value)).collect();
    assert_eq!(
        values,
        [
            (SafePlace::Port(0x378), 1, 0),
            (SafePlace::Port(0x207e), 2, 0xffff),
            (SafePlace::Register { memory: 0, offset: 0xffc }, 4, u32::MAX),
        ]
    );
    let shared: Vec<bool> = other.passthrough().ports.iter().map(|p| p.shared_with_host).collect();
    assert_eq!(shared, [false, true]);
}

#[test]
fn memory_behind_vfio_interrupts_the_windows_of_others_when_its_partition_starts_anew() {
    let text = fs::read_to_string("tests/partition_files/good/passthrough.toml").unwrap();
    // That of the memory's own function; the other function's table is of ports.
    let text = text.replace("trusted_dma = true", "vfio = true");
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("vfio.toml");
    fs::write(&path, text).unwrap();
    let with_vfio = config::load(&path, None).unwrap_or_else(|error| panic!("{error}"));
    let new_starts = |file: &PartitionFile| {
        file.partitions().iter().map(|p| p.interrupts().new_starts).collect::<Vec<_>>()
    };
    assert_eq!((new_starts(&file()), new_starts(&with_vfio)), (vec![0, 0], vec![0, 1]));
}

#[test]
fn the_report_lists_the_devices_last() {
    let report = check::report(&file());
    let (_, devices) = report.split_once("\ndevices of this machine\n").unwrap();
    let expected = "  plc
    ports 0x378 to 0x37a
    ports 0x2000 to 0x207f: register 1 of 0000:00:10.0, taken from its driver, DMA to the partition's memory
    card at 0xd0000000 to 0xd0000fff: register 0 of 0000:00:06.0, trusted with DMA
    timer at 0xd0001000 to 0xd0001fff: physical 0xfed00000, shared with the host
    coupler at 0xd0002000 to 0xd0003fff: map 1 of uio0
    interrupt 32: of 0000:00:06.0
    interrupt 254: of uio0
    at its end 0x00 to port 0x378
    at its end 0xffff to port 0x207e
    warning: a reset of 0000:00:10.0 undoes this value when takt ends (vfio)
    at its end 0xffffffff to card + 0xffc
  other
    ports 0x3f8 to 0x3ff
    ports 0x70 to 0x71, shared with the host
";
    assert_eq!(devices, expected);
}

#[test]
fn a_disk_is_only_read_unless_the_file_says_otherwise_and_a_script_is_told_of_it() {
    let file = load("good/disks.toml");
    let [plc, linux] = file.partitions() else { panic!() };
    assert!(plc.disks().is_empty());
    let disks: Vec<(&str, bool)> =
        linux.disks().iter().map(|d| (name(&d.path), d.read_only)).collect();
    assert_eq!(disks, [("dummy-disk", true), ("other-disk", false)]);
    let needs = check::needs(&file);
    for disk in linux.disks() {
        assert!(needs.contains(&format!("file {}\n", disk.path.display())), "{needs}");
    }
}

fn name(path: &Path) -> &str {
    path.file_name().unwrap().to_str().unwrap()
}

#[test]
fn can_objects_are_numbered_for_the_guest_with_all_their_fields_together() {
    use takt_abi::can::{Controller, EXTENDED, ON_CHANGE, Object};
    use takt_abi::io::{INPUT, MAPPINGS_MAX, OUTPUT, kind};

    let file = load("good/can.toml");
    let table = file.partitions()[0].io_table();
    let [bus, slow] = [table.controllers[0], table.controllers[1]];
    assert!(bus.name.starts_with(b"bus\0") && slow.name.starts_with(b"slow\0"));
    assert_eq!(
        [bus, slow].map(|c| (c.place, c.kind, c.stride, c.frames, c.kbit_per_s)),
        [(0x2000, kind::PORT, 1, 2, 500), (0xd000_0100, kind::REGISTER, 4, 4, 125)]
    );
    assert_eq!(table.controllers[2], Controller::NONE);
    let object = |identifier, controller, direction, bytes, flags| Object {
        identifier,
        controller,
        direction,
        bytes,
        flags,
    };
    assert_eq!(
        table.objects[..6],
        [
            object(0x181, 0, INPUT, 6, 0),
            object(0x18ff_0181 | EXTENDED, 1, INPUT, 8, 0),
            object(0x201, 0, OUTPUT, 8, 0),
            object(0x201, 1, OUTPUT, 1, ON_CHANGE),
            object(0x201 | EXTENDED, 0, OUTPUT, 4, 0),
            Object::NONE,
        ]
    );
    let mappings = &table.mappings[..table.count as usize];
    assert!(table.count as usize <= MAPPINGS_MAX);
    let told: Vec<_> =
        mappings.iter().map(|m| (m.program, m.direction, m.kind, m.place, m.field)).collect();
    assert_eq!(
        told,
        [
            (0, INPUT, kind::CAN_AGE, 0, 0),
            (0, INPUT, kind::CAN_COUNT, 0, 0),
            (0, INPUT, kind::CAN, 0, 1),
            (0, INPUT, kind::CAN, 0, 2),
            (0, OUTPUT, kind::CAN, 2, 0),
            (0, OUTPUT, kind::CAN, 2, 4),
            (1, INPUT, kind::CAN, 0, 0),
            (1, INPUT, kind::CAN, 1, 4),
            (1, OUTPUT, kind::CAN, 3, 0),
            (1, OUTPUT, kind::CAN, 4, 0),
        ]
    );
    let report = check::report(&file);
    for line in [
        "CAN bus, object 0x181, byte 1, bit 7",
        "CAN bus, object 0x181, its age",
        "CAN slow, object 0x18ff0181, byte 4, read by slow",
        "CAN slow, object 0x201, byte 0, held at a stop",
        "  CAN bus at I/O port 0x2000, 500kbit/s
    objects: 1 received, 2 sent; of each job at most 32 register accesses before it and 30 behind it
  CAN slow at memory 0xd0000100, 125kbit/s
    objects: 1 received, 1 sent; of each job at most 64 register accesses before it and 15 behind it
",
    ] {
        assert!(report.contains(line), "no {line:?} in\n{report}");
    }
}
