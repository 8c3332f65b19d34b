//! Serving requests, on the disk's own thread.

use std::io::{self, ErrorKind};
use std::sync::Arc;
use std::sync::atomic::Ordering;
use std::time::{Duration, Instant};

use virtio_bindings::virtio_blk::{
    VIRTIO_BLK_ID_BYTES, VIRTIO_BLK_S_IOERR, VIRTIO_BLK_S_OK, VIRTIO_BLK_S_UNSUPP,
    VIRTIO_BLK_T_DISCARD, VIRTIO_BLK_T_FLUSH, VIRTIO_BLK_T_GET_ID, VIRTIO_BLK_T_IN,
    VIRTIO_BLK_T_OUT,
};
use virtio_queue::{Queue, QueueT};
use vm_memory::{Bytes, GuestMemoryMmap};

use super::handover::{Handover, Lease, Recalled};
use super::request::{Body, Request, total};
use super::transfer::{Guest, Transfer};
use super::{BUFFER_ALIGNMENT, DISCARD_SECTORS_MAX, Medium, PIECE_BYTES, SECTOR, Shape};

/// What a guest learns as the disk's serial number; zeros behind it.
pub type DiskId = [u8; VIRTIO_BLK_ID_BYTES as usize];

/// How long an answer may wait for those behind it before the guest is interrupted.
const UNTOLD_MAX: Duration = Duration::from_millis(1);

/// A disk, apart from how a guest reaches it.
pub struct Disk<M> {
    /// What it is.
    pub shape: Shape,
    /// How the guest knows it.
    pub id: DiskId,
    /// Where its bytes are.
    pub medium: M,
}

/// What takes requests out of a queue and makes answers of them.
pub struct Server<M> {
    /// Between the guest's vCPU and this.
    shared: Arc<Handover>,
    /// Only the guest's RAM. The rest of what the guest sees does not belong in here: what it may only read, the
    /// disk would write for it.
    memory: GuestMemoryMmap,
    disk: Disk<M>,
    /// Where bytes are between the guest's memory and the medium.
    buffer: Box<[u8]>,
    /// Where in the buffer they begin, so that they are aligned.
    start: usize,
}

/// How a request ended.
struct Answer {
    status: u32,
    /// Bytes that were written to the guest's memory, without the status.
    bytes: u64,
    /// What the medium failed with.
    failure: Option<io::Error>,
}

impl Answer {
    const fn good(bytes: u64) -> Self {
        Self { status: VIRTIO_BLK_S_OK, bytes, failure: None }
    }

    const fn error(status: u32) -> Self {
        Self { status, bytes: 0, failure: None }
    }

    fn of(result: io::Result<()>, bytes: u64) -> Self {
        match result {
            Ok(()) => Self::good(bytes),
            Err(error) if error.kind() == ErrorKind::Unsupported => {
                Self::error(VIRTIO_BLK_S_UNSUPP)
            }
            Err(error) => Self { failure: Some(error), ..Self::error(VIRTIO_BLK_S_IOERR) },
        }
    }
}

/// Why a queue is not served to its end.
enum Stop {
    /// The rings are not what rings are.
    Broken,
    /// It is the guest's again.
    Recalled,
}

impl From<Recalled> for Stop {
    fn from(_: Recalled) -> Self {
        Self::Recalled
    }
}

impl<M: Medium> Server<M> {
    /// A server of this disk.
    #[must_use]
    pub fn new(shared: Arc<Handover>, memory: GuestMemoryMmap, disk: Disk<M>) -> Self {
        let buffer = vec![0; PIECE_BYTES + BUFFER_ALIGNMENT].into_boxed_slice();
        let start = buffer.as_ptr().align_offset(BUFFER_ALIGNMENT);
        Self { shared, memory, disk, buffer, start }
    }

    /// Serves the requests that wait now, which are a queue full at most. Those that come meanwhile
    /// have a notification of their own. True if the guest is to be interrupted: once for all of
    /// them, since an interrupt costs it more than most requests. If some take long, `early` interrupts it for those
    /// that are done.
    #[must_use]
    pub fn serve(&mut self, mut early: impl FnMut()) -> bool {
        let Some((mut queue, lease)) = self.shared.take() else { return false };
        match self.serve_queue(&mut queue, &lease, &mut early) {
            Ok(answered) => self.shared.give_back(&lease, Some((queue, answered))),
            Err(Stop::Broken) => self.shared.give_back(&lease, None),
            Err(Stop::Recalled) => false,
        }
    }

    fn serve_queue(
        &mut self,
        queue: &mut Queue,
        lease: &Lease,
        early: &mut impl FnMut(),
    ) -> Result<bool, Stop> {
        if !queue.is_valid(&self.memory) {
            return Err(Stop::Broken);
        }
        let available = queue.avail_idx(&self.memory, Ordering::Acquire);
        let available = available.map_err(|_| Stop::Broken)?;
        let waiting = available.0.wrapping_sub(queue.next_avail());
        if waiting > queue.size() {
            return Err(Stop::Broken);
        }
        // Since when there is an answer of which the guest does not know.
        let mut untold: Option<Instant> = None;
        for _ in 0..waiting {
            self.serve_one(queue, lease, |slow| {
                if untold.is_some_and(|since| slow || since.elapsed() >= UNTOLD_MAX) {
                    untold = None;
                    early();
                }
            })?;
            untold.get_or_insert_with(Instant::now);
        }
        Ok(waiting > 0)
    }

    /// `before` is called first, while the lease holds, and told whether the request may be slow.
    fn serve_one(
        &mut self,
        queue: &mut Queue,
        lease: &Lease,
        before: impl FnOnce(bool),
    ) -> Result<(), Stop> {
        let Self { shared, memory, disk, buffer, start } = self;
        let (memory, shared) = (&*memory, &**shared);
        let buffer = buffer.get_mut(*start..).unwrap_or_default();
        if !shared.holds(lease) {
            return Err(Stop::Recalled);
        }
        let chain = queue.pop_descriptor_chain(memory).ok_or(Stop::Broken)?;
        let request = Request::parse(chain, memory).map_err(|_| Stop::Broken)?;
        let kind = request.body.as_ref().map(|body| body.kind);
        let slow = matches!(kind, Some(VIRTIO_BLK_T_FLUSH | VIRTIO_BLK_T_DISCARD));
        shared.touch(lease, || before(slow))?;
        let answer = match &request.body {
            Some(body) => disk.answer(body, buffer, Guest { shared, lease })?,
            None => Answer::error(VIRTIO_BLK_S_IOERR),
        };
        if let Some(error) = answer.failure {
            shared.note(error);
        }
        // Counted from the first writable byte: the status lies behind what was not filled.
        let bytes = u32::try_from(answer.bytes + 1).map_err(|_| Stop::Broken)?;
        let answered = shared.touch(lease, || {
            memory.write_obj(answer.status as u8, request.status).map_err(|_| Stop::Broken)?;
            queue.add_used(memory, request.head, bytes).map_err(|_| Stop::Broken)
        });
        answered?
    }
}

impl<M: Medium> Disk<M> {
    fn answer(
        &mut self,
        body: &Body<'_>,
        buffer: &mut [u8],
        guest: Guest<'_>,
    ) -> Result<Answer, Recalled> {
        let (from, into) = (total(&body.from), total(&body.into));
        Ok(match body.kind {
            VIRTIO_BLK_T_IN if from == 0 => match self.place(body.sector, into) {
                Some(at) => {
                    let transfer = Transfer { buffer, guest, at, slices: &body.into };
                    Answer::of(transfer.read(&mut self.medium)?, into)
                }
                None => Answer::error(VIRTIO_BLK_S_IOERR),
            },
            VIRTIO_BLK_T_OUT if into == 0 && !self.shape.read_only => {
                match self.place(body.sector, from) {
                    Some(at) => {
                        let transfer = Transfer { buffer, guest, at, slices: &body.from };
                        Answer::of(transfer.write(&mut self.medium)?, 0)
                    }
                    None => Answer::error(VIRTIO_BLK_S_IOERR),
                }
            }
            VIRTIO_BLK_T_FLUSH if from == 0 && into == 0 => Answer::of(self.medium.flush(), 0),
            VIRTIO_BLK_T_DISCARD if into == 0 && !self.shape.read_only => {
                self.discard(guest.touch(|| body.discarded())?)
            }
            VIRTIO_BLK_T_GET_ID if from == 0 => guest.touch(|| self.tell_id(body))?,
            VIRTIO_BLK_T_IN | VIRTIO_BLK_T_OUT | VIRTIO_BLK_T_FLUSH | VIRTIO_BLK_T_DISCARD
            | VIRTIO_BLK_T_GET_ID => Answer::error(VIRTIO_BLK_S_IOERR),
            _ => Answer::error(VIRTIO_BLK_S_UNSUPP),
        })
    }

    /// Where a transfer begins, in bytes, if there is all of it.
    fn place(&self, sector: u64, bytes: u64) -> Option<u64> {
        let end = sector.checked_add(bytes / SECTOR)?;
        let is_good = bytes > 0 && bytes.is_multiple_of(SECTOR) && end <= self.shape.sectors;
        is_good.then(|| sector.checked_mul(SECTOR)).flatten()
    }

    /// One piece, as the driver was told. All flags are reserved here (virtio 1.2, section 5.2.6.2).
    fn discard(&mut self, named: Option<(u64, u32, u32)>) -> Answer {
        let Some((sector, sectors, flags)) = named else {
            return Answer::error(VIRTIO_BLK_S_IOERR);
        };
        if flags != 0 {
            return Answer::error(VIRTIO_BLK_S_UNSUPP);
        }
        let bytes = u64::from(sectors) * SECTOR;
        match self.place(sector, bytes) {
            Some(at) if sectors <= DISCARD_SECTORS_MAX => {
                Answer::of(self.medium.discard(at, bytes), 0)
            }
            _ => Answer::error(VIRTIO_BLK_S_IOERR),
        }
    }

    fn tell_id(&self, body: &Body<'_>) -> Answer {
        if total(&body.into) != self.id.len() as u64 {
            return Answer::error(VIRTIO_BLK_S_IOERR);
        }
        let mut rest: &[u8] = &self.id;
        for slice in &body.into {
            // The length was compared, so there is as much as the pieces take.
            let Some((part, behind)) = rest.split_at_checked(slice.len()) else { break };
            slice.copy_from(part);
            rest = behind;
        }
        Answer::good(self.id.len() as u64)
    }
}
