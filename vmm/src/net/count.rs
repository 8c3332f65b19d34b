//! What has gone through a tap device, by the kernel's own counts. The files are opened before the run, since
//! nothing of the host can be opened later.

use std::fs::File;
use std::os::unix::fs::FileExt;

use super::NetError;
use crate::report::Traffic;

/// The counts of a tap device: to the guest, and from it.
pub struct Counts([[File; 3]; 2]);

impl Counts {
    /// Those of the device of this name.
    ///
    /// # Errors
    /// If they are not there.
    pub fn of(tap: &str) -> Result<Self, NetError> {
        let open = |direction: &str, what: &str| {
            let path = format!("/sys/class/net/{tap}/statistics/{direction}_{what}");
            File::open(&path).map_err(|source| NetError::Count { path, source })
        };
        // What the host's end transmits, the guest receives.
        let of = |direction| -> Result<[File; 3], NetError> {
            let file = |what| open(direction, what);
            Ok([file("packets")?, file("bytes")?, file("dropped")?])
        };
        Ok(Self([of("tx")?, of("rx")?]))
    }

    /// What they say now; `None` if the device is gone.
    pub fn read(&self) -> [Option<Traffic>; 2] {
        self.0.each_ref().map(|files| {
            let [packets, bytes, dropped] = files.each_ref().map(number);
            Some(Traffic { packets: packets?, bytes: bytes?, dropped: dropped? })
        })
    }
}

fn number(file: &File) -> Option<u64> {
    let mut text = [0; 24];
    let read = file.read_at(&mut text, 0).ok()?;
    str::from_utf8(text.get(..read)?).ok()?.trim_end().parse().ok()
}
