//! The regions of a peer that writes into them whatever it likes.
//!
//! The tests of the channel crate have a peer that attacks between any two looks; here a fuzzer
//! chooses what lies there, and how the channel is shaped.

use std::ptr::NonNull;

use takt_channel::{
    Bystander, Geometry, OpenError, OwnPages, PeerPages, Policy, QueuingDestination, QueuingSource,
    SamplingDestination, Ticks, Tsc, offset,
};

/// Messages that are taken from one region or put into it, at most.
const CALLS: u64 = 64;

/// A region as the VMM makes it, and then as its owner likes it, but for the header: no end that
/// finds another one there goes on.
struct Region(Vec<u64>);

impl Region {
    fn new(
        bytes: usize,
        format: impl FnOnce(&mut OwnPages<'_>) -> Result<(), OpenError>,
        data: &[u8],
    ) -> Region {
        let mut region = Region(vec![0; bytes.div_ceil(8)]);
        format(&mut region.own()).expect("the region is as long as it must be");
        let body = region.0.iter_mut().skip(offset::EPOCH / 8);
        for (word, bytes) in body.zip(data.chunks(8)) {
            let mut whole = [0; 8];
            whole[..bytes.len()].copy_from_slice(bytes);
            *word = u64::from_le_bytes(whole);
        }
        region
    }

    fn peer(&mut self) -> PeerPages<'_> {
        let bytes = self.0.len() * 8;
        // SAFETY: the block is that long, and borrowed for as long as the pages live.
        unsafe { PeerPages::new(NonNull::from(self.0.as_mut_slice()).cast(), bytes) }
            .expect("words are aligned")
    }

    fn own(&mut self) -> OwnPages<'_> {
        let bytes = self.0.len() * 8;
        // SAFETY: as above.
        unsafe { OwnPages::new(NonNull::from(self.0.as_mut_slice()).cast(), bytes) }
            .expect("words are aligned")
    }
}

/// Reads from such regions with each kind of end.
///
/// # Panics
/// If an end takes a message that is longer than the channel's longest, or believes its peer about
/// the channel's shape.
pub fn run(data: &[u8]) {
    let [shape, maximum, depth, data @ ..] = data else { return };
    let (maximum, depth) = (u32::from(*maximum) + 1, u32::from(*depth % 8) + 1);
    let policy = if shape & 1 == 0 { Policy::Refuse } else { Policy::Overwrite };
    let shapes = (Geometry::sampling(maximum), Geometry::queuing(maximum, depth, policy));
    let (Ok(sampling), Ok(queuing)) = shapes else { return };
    let mut buffer = vec![0; maximum as usize];
    sample(&sampling, data, &mut buffer);
    // Both ends of a queue: what one takes for the peer's is the other's own, of an earlier life.
    let source = || Region::new(queuing.source_bytes(), |r| queuing.format_source(r), data);
    let (bytes, acknowledged) = (queuing.destination_bytes(), &data[..data.len().min(64)]);
    let destination = || Region::new(bytes, |r| queuing.format_destination(r), acknowledged);
    receive(&queuing, depth, &mut source(), &mut destination(), &mut buffer);
    send(&queuing, depth, &mut source(), &mut destination(), &buffer);
    look(&queuing, depth, &mut source(), &mut destination());
}

fn sample(geometry: &Geometry, data: &[u8], buffer: &mut [u8]) {
    let mut peer = Region::new(geometry.source_bytes(), |r| geometry.format_source(r), data);
    let end = SamplingDestination::attach(peer.peer(), geometry, Ticks(1000));
    let mut end = end.expect("the header is good");
    for now in [u64::MAX, 0] {
        let _ = end.read(buffer, Tsc(now));
    }
    assert_eq!(end.status().maximum, buffer.len());
}

fn receive(
    geometry: &Geometry,
    depth: u32,
    peer: &mut Region,
    own: &mut Region,
    buffer: &mut [u8],
) {
    let Ok(mut end) = QueuingDestination::attach(peer.peer(), own.own(), geometry) else { return };
    for _ in 0..CALLS {
        if end.receive(buffer).is_err() {
            break;
        }
    }
    let status = end.status();
    assert!(status.waiting <= status.depth && status.depth == depth);
    end.clear();
}

fn send(geometry: &Geometry, depth: u32, own: &mut Region, peer: &mut Region, message: &[u8]) {
    let Ok(mut end) = QueuingSource::attach(own.own(), peer.peer(), geometry) else { return };
    for stamp in 0..CALLS {
        if end.send(message, Tsc(stamp)).is_err() {
            break;
        }
    }
    let status = end.status();
    assert!(status.waiting <= status.depth && status.depth == depth);
}

/// Both regions are a stranger's here.
fn look(geometry: &Geometry, depth: u32, source: &mut Region, destination: &mut Region) {
    let bystander = Bystander::queuing(source.peer(), destination.peer(), geometry);
    if let Ok(sight) = bystander.expect("the regions are long enough").look() {
        assert!(sight.waiting <= depth && u64::from(sight.waiting) + sight.overwritten < 1 << 62);
    }
}
