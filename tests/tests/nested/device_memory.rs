//! The ways in which a PLC comes by what the host has: an address, a UIO driver, a driver of the host's
//! that has to let go.

use std::fs;

use takt_tests::{File, Host, plc_image, target};

use crate::passthrough::count;

/// A register of 0xd0000000, where `outputs` looks for it, and a safe value behind the one that it
/// writes.
fn memory(source: &str) -> String {
    format!(
        "[[partition.mmio]]\nname = \"edu\"\naddress = \"0xd0000000\"\nsize = \"4KiB\"\n{source}\n\
         [[partition.safe_value]]\nmmio = \"edu\"\noffset = \"0x8\"\nwidth = 4\nvalue = \"0x5afe\""
    )
}

#[ignore = "only in the long form: scripts/test --long"]
#[test]
fn memory_of_devices_comes_by_its_address_by_uio_and_from_a_driver_of_the_hosts() {
    let outputs = plc_image("outputs");
    let drive = |name: &str, source: &str| {
        let file = File::new("1ms").plc("drive", Some(outputs.clone()), &memory(source));
        file.schedule("normal").window("drive", 0, 200).save(name)
    };
    let can = plc_image("can");
    let two_cards = |name: &str, unbind: bool| {
        let ports = format!(
            "[[partition.port_io]]\nports = \"0x2000-0x201f\"\npci = \"0000:00:10.0\"\nbar = 1\n\
             unbind = {unbind}\n[[partition.port_io]]\nports = \"0x2400-0x247f\"\n\
             pci = \"0000:00:11.0\"\nbar = 0"
        );
        let file = File::new("1ms").plc("plc", Some(can.clone()), &ports);
        file.schedule("normal").window("plc", 0, 500).save(name)
    };
    let files = [
        drive("physical", "physical = \"EDU\""),
        drive("uio", "uio = \"uio0\"\nmap = 0"),
        two_cards("driver", false),
        two_cards("unbound", true),
    ];
    // What the guest takes for an edu: its identification.
    let shared = target("tests/shared");
    let mut contents = vec![0; 1 << 20];
    contents[..4].copy_from_slice(&0x0100_00ed_u32.to_le_bytes());
    fs::write(&shared, contents).expect("the file can be written");

    let host = Host::new()
        .with("--device", "edu")
        .with("--device", &format!("shared={}", shared.display()))
        .with("--device", "can")
        .with("--module", "uio_netx")
        .with("--module", "kvaser_pci")
        .with_file(&outputs)
        .with_file(&can);
    let host = files.iter().fold(host, |host, file| host.with_file(file));
    let outcome = host.run("take-devices", &files.each_ref().map(|file| file.to_str().unwrap()));
    assert_eq!(outcome.status, 0, "{}", outcome.output);
    assert!(!outcome.output.contains("wrong: "), "{}", outcome.output);
    outcome.assert_shows("== all is as it was");
    let part = |begin: &str, end: &str| {
        let (_, rest) = outcome.output.split_once(begin).expect(begin);
        rest.split_once(end).expect(end).0.to_owned()
    };

    // By its address: the complement of each number came back. RAM is refused.
    let physical = part("== physical", "== uio");
    assert!(physical.contains("ticks of a write to a register: "), "{physical}");
    assert!(physical.contains(", 0 wrong"), "{physical}");
    assert!(physical.contains(" are RAM, not a device"), "{physical}");

    // By UIO: what is only memory gives the number itself back, and so it is there at the end.
    let uio = part("== uio", "== a driver of the host's");
    assert!(uio.contains(", 100 wrong"), "{uio}");
    let memory = fs::read(&shared).expect("QEMU has the file open, no more");
    let word = |at: usize| u32::from_le_bytes(memory[at..at + 4].try_into().unwrap());
    assert!((900..1_100).contains(&word(4)), "{}", word(4));
    assert_eq!(word(8), 0x5afe);

    // From a driver: first not without a word in the file, and then the card works.
    let driver = part("== a driver of the host's", "== all is as it was");
    assert!(driver.contains("0000:00:10.0 is in use by the host's driver kvaser_pci"), "{driver}");
    let taken =
        "0000:00:10.0 for plc: taken from the host's driver kvaser_pci, bus mastering is off";
    assert!(driver.contains(taken), "{driver}");
    assert!(count(&outcome, "sent") >= 900, "{driver}");
    assert_eq!(count(&outcome, "sent"), count(&outcome, "received"), "{driver}");
}
