//! What a driver sees of the disk (virtio 1.2, section 5.2): features, configuration, one queue.

use std::sync::Arc;

use virtio_bindings::virtio_blk::{
    VIRTIO_BLK_F_DISCARD, VIRTIO_BLK_F_FLUSH, VIRTIO_BLK_F_RO, VIRTIO_BLK_F_SEG_MAX,
    VIRTIO_BLK_F_SIZE_MAX,
};
use virtio_bindings::virtio_config::VIRTIO_F_VERSION_1;
use virtio_bindings::virtio_ids::VIRTIO_ID_BLOCK;
use virtio_bindings::virtio_ring::VIRTIO_RING_F_INDIRECT_DESC;
use virtio_queue::Queue;

use super::handover::Handover;
use super::{
    DISCARD_ALIGNMENT, DISCARD_SECTORS_MAX, QUEUE_SIZE, SEGMENT_BYTES_MAX, SEGMENTS_MAX, Shape,
};
use crate::virtio::{BadQueues, Description, Device, bits};

/// Where the configuration says what may be discarded: most sectors, most pieces, alignment (virtio 1.2, section 5.2.4).
const DISCARD_AT: usize = 36;

/// The side of a disk that is the guest's.
pub struct DiskDevice {
    description: Description,
    shared: Arc<Handover>,
}

impl DiskDevice {
    /// Of a disk of this shape, whose queue is served by who has the other end of `shared`.
    #[must_use]
    pub fn new(shape: Shape, shared: Arc<Handover>) -> Self {
        let mut config = shape.sectors.to_le_bytes().to_vec();
        config.extend(SEGMENT_BYTES_MAX.to_le_bytes());
        config.extend((SEGMENTS_MAX as u32).to_le_bytes());
        // Between them are fields that belong to features which are not offered.
        config.resize(DISCARD_AT, 0);
        config.extend(
            [DISCARD_SECTORS_MAX, 1, DISCARD_ALIGNMENT].map(u32::to_le_bytes).as_flattened(),
        );
        let kind = if shape.read_only { VIRTIO_BLK_F_RO } else { VIRTIO_BLK_F_FLUSH };
        // A driver that would do less might take what it has written for safe before it is.
        let required = bits(&[VIRTIO_F_VERSION_1, kind]);
        let mut optional =
            bits(&[VIRTIO_BLK_F_SIZE_MAX, VIRTIO_BLK_F_SEG_MAX, VIRTIO_RING_F_INDIRECT_DESC]);
        if !shape.read_only {
            optional |= bits(&[VIRTIO_BLK_F_DISCARD]);
        }
        let description = Description {
            id: VIRTIO_ID_BLOCK,
            offered: required | optional,
            required,
            queues: 1,
            queue_size: QUEUE_SIZE,
            config,
        };
        Self { description, shared }
    }
}

impl Device for DiskDevice {
    fn description(&self) -> &Description {
        &self.description
    }

    fn start(&mut self, _: u64, queues: Vec<Option<Queue>>) -> Result<(), BadQueues> {
        let Some(queue) = queues.into_iter().next().flatten() else {
            self.shared.broke();
            return Err(BadQueues);
        };
        self.shared.enable(queue);
        Ok(())
    }

    fn recall(&mut self, _: usize) {
        self.shared.recall();
    }

    fn reset(&mut self) {
        self.shared.recall();
    }
}
