//! What a program has of its retained values at a start of its guest.

use std::sync::Arc;

use takt_abi::program::restored;
use takt_program::Image;
use takt_retain::Layout;

use super::StartMode;

/// The newest values of one cycle.
#[derive(Clone, Debug)]
pub struct Kept {
    /// Of the version that they are of.
    pub layout: Arc<Layout>,
    /// The values.
    pub block: Vec<u8>,
    /// RETAIN values are in it too; false after a download, with which only PERSISTENT ones come.
    pub retain: bool,
}

impl Kept {
    /// What a program of this image begins with: one of [`restored`], and the block.
    #[must_use]
    pub fn beginning(&self, image: &[u8], mode: StartMode) -> (u32, Vec<u8>) {
        let nothing = (restored::NOTHING, Vec::new());
        let Ok(image) = Image::parse(image) else { return nothing };
        let own;
        let (layout, block) = if image.hash() == self.layout.image() {
            (&*self.layout, self.block.clone())
        } else {
            // A version that was entered after the values were copied.
            own = Layout::of(&image);
            (&own, own.carry(&self.layout, &self.block))
        };
        match mode {
            StartMode::Warm if self.retain => (restored::ALL, block),
            _ if !layout.has_persistent() => nothing,
            _ => layout.cold(&block).map_or(nothing, |block| (restored::PERSISTENT, block)),
        }
    }
}

#[cfg(test)]
#[path = "retained_tests.rs"]
mod tests;
