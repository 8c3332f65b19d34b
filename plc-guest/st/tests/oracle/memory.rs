//! Memory by address.

/// Where the frames of routines lie.
const FRAMES: u64 = 0x7000_0000_0000;
const FRAME_BYTES: usize = 1 << 20;

/// Regions of bytes at fixed addresses, and a stack.
pub struct Memory {
    regions: Vec<(u64, Vec<u8>)>,
    frames: Vec<u8>,
    top: usize,
}

impl Memory {
    pub fn new() -> Memory {
        Memory { regions: Vec::new(), frames: vec![0; FRAME_BYTES], top: 0 }
    }

    pub fn map(&mut self, address: u64, bytes: usize) {
        self.regions.push((address, vec![0; bytes]));
    }

    pub fn mark(&self) -> usize {
        self.top
    }

    pub fn release(&mut self, mark: usize) {
        self.top = mark;
    }

    pub fn allocate(&mut self, bytes: usize) -> u64 {
        let at = self.top.next_multiple_of(8);
        self.top = at + bytes.max(1);
        assert!(self.top <= FRAME_BYTES, "the program of this test needs a deeper stack");
        FRAMES + at as u64
    }

    fn bytes(&mut self, address: u64, size: usize) -> &mut [u8] {
        let (start, region) = if address >= FRAMES {
            (FRAMES, &mut self.frames)
        } else {
            let found = self.regions.iter_mut().find(|(start, bytes)| {
                *start <= address && address + size as u64 <= *start + bytes.len() as u64
            });
            let (start, region) =
                found.unwrap_or_else(|| panic!("{size} bytes at {address:#x} are not mapped"));
            (*start, region)
        };
        let at = (address - start) as usize;
        &mut region[at..at + size]
    }

    pub fn read(&mut self, address: u64, size: usize) -> Vec<u8> {
        self.bytes(address, size).to_vec()
    }

    pub fn write(&mut self, address: u64, bytes: &[u8]) {
        self.bytes(address, bytes.len()).copy_from_slice(bytes);
    }
}
