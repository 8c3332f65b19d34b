//! Whether another version of a program has the room that the partition file gives it, and a key that the file names.

use takt_abi::memory::PAGE;
use takt_program::Image;
use takt_retain::{LENGTH_MAX, Layout};

use super::programs::Program;
use super::retain::PIECES_MAX;

impl Program {
    /// Whether a version may take the place of the one that runs. Nothing is said of the change to it.
    ///
    /// # Errors
    /// Why it may not.
    pub fn may_become(&self, new: &Image<'_>) -> Result<(), String> {
        if let Some(keys) = &self.keys {
            match new.key() {
                Some(key) if keys.contains(&key) => {}
                Some(_) => {
                    return Err(
                        "the image is signed with a key that the partition file does not name"
                            .to_owned(),
                    );
                }
                None => {
                    return Err(
                        "the image is not signed, and the partition file names keys".to_owned()
                    );
                }
            }
        }
        if u64::from(new.state_bytes()) > self.place.state_bytes {
            return Err(format!(
                "the version needs {} bytes of state; the key `state` of the partition file gives it {}",
                new.state_bytes(),
                self.place.state_bytes
            ));
        }
        let (retained, most) = (Layout::block_bytes(new), self.place.retained_bytes);
        if retained > most {
            return Err(format!(
                "the version retains {retained} bytes; the program has room for {most}"
            ));
        }
        let layout = Layout::of(new);
        if layout.pieces() > PIECES_MAX || layout.file_bytes() > LENGTH_MAX {
            return Err(format!(
                "the version retains {retained} bytes in {} pieces of memory and {} bytes of a file; the program has room for \
                 {most}, {PIECES_MAX} and {LENGTH_MAX}",
                layout.pieces(),
                layout.file_bytes()
            ));
        }
        Ok(())
    }

    /// Where both plans of a change lie in a bank, behind the image; these are the bytes of all three.
    ///
    /// # Errors
    /// If there is no room for them.
    pub fn plans_in_bank(&self, [image, forward, back]: [u64; 3]) -> Result<[u64; 2], String> {
        let forward_at = image.next_multiple_of(PAGE);
        let back_at = (forward_at + forward).next_multiple_of(8);
        let (end, most) = (back_at + back, self.place.bank_bytes);
        if end > most {
            return Err(format!(
                "image and plans have {end} bytes; the program's bank has {most}. The key `bank` of the partition file \
                 makes it larger"
            ));
        }
        Ok([forward_at, back_at])
    }
}
