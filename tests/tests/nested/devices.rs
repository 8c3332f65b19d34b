//! Devices of the emulated machine, as a partition's table has them.

/// A parallel port, on which the byte 0xa5 is printed when its owner has ended. The owner may
/// have been stopped with the strobe on, so that goes off first.
pub const PRINTER: &str = r#"
[[partition.port_io]]
ports = "0x378-0x37a"

[[partition.safe_value]]
port = "0x37a"
width = 1
value = "0x0c"

[[partition.safe_value]]
port = "0x378"
width = 1
value = "0xa5"

[[partition.safe_value]]
port = "0x37a"
width = 1
value = "0x0d"

[[partition.safe_value]]
port = "0x37a"
width = 1
value = "0x0c"
"#;

/// The registers of QEMU's `edu`.
pub const EDU: &str = r#"
[[partition.mmio]]
name = "edu"
address = "0xd0000000"
size = "4KiB"
pci = "0000:00:06.0"
bar = 0
"#;

/// Its interrupt.
pub const EDU_INTERRUPT: &str = r#"
[[partition.interrupt]]
vector = 64
pci = "0000:00:06.0"
"#;
