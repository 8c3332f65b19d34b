//! Which Linuxes programs of the host reach without a network. It is the same under every schedule, and so is shown
//! once.

use super::line;
use crate::PartitionFile;

/// The number of each, in the order of the file; nothing if there is none.
pub fn list(out: &mut String, file: &PartitionFile) {
    let mut begun = false;
    for partition in file.partitions() {
        let Some(cid) = partition.vsock() else { continue };
        if !begun {
            out.push_str("\nsockets to the host (vsock)\n");
            begun = true;
        }
        line(out, &format!("  {}: {cid}", partition.name()));
    }
}
