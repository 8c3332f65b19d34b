//! The targets, one file for each door.

pub mod channel_peer;
pub mod control_line;
pub mod disk;
pub mod images;
pub mod linux_ports;
pub mod partition_file;
pub mod plc_exits;
pub mod program_image;
pub mod retained_values;
mod scratch;
pub mod structured_text;
