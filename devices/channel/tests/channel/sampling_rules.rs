//! One test for each rule of the sampling port.

use takt_channel::{
    Geometry, LengthError, OpenError, ReadError, ReturnCode, Sample, SamplingDestination,
    SamplingSource, Ticks, Tsc, Validity, offset,
};

use crate::memory::Region;

const MAXIMUM: usize = 20;
const REFRESH: Ticks = Ticks(100);

struct Channel {
    geometry: Geometry,
    region: Region,
}

impl Channel {
    fn new() -> Channel {
        let geometry = Geometry::sampling(MAXIMUM as u32).unwrap();
        Channel { region: Region::source(&geometry), geometry }
    }

    fn source(&self) -> SamplingSource<Region> {
        SamplingSource::open(self.region.clone(), &self.geometry).unwrap()
    }

    fn destination(&self) -> SamplingDestination<Region> {
        SamplingDestination::open(self.region.clone(), &self.geometry, REFRESH).unwrap()
    }
}

fn read<'b>(
    destination: &mut SamplingDestination<Region>,
    buffer: &'b mut [u8; MAXIMUM],
    now: u64,
) -> Result<Sample<'b>, ReadError> {
    destination.read(buffer, Tsc(now))
}

#[test]
fn a_refresh_period_that_is_not_positive_is_invalid_config() {
    let channel = Channel::new();
    let opened = SamplingDestination::open(channel.region.clone(), &channel.geometry, Ticks(0));
    assert_eq!(
        opened.map_err(|e| (e, e.code())).unwrap_err(),
        (OpenError::Refresh, ReturnCode::InvalidConfig)
    );
}

#[test]
fn opening_a_destination_empties_it() {
    let channel = Channel::new();
    let mut source = channel.source();
    source.write(b"before", Tsc(1)).unwrap();
    let mut destination = channel.destination();
    let mut buffer = [0; MAXIMUM];
    assert_eq!(read(&mut destination, &mut buffer, 1), Err(ReadError::NeverWritten));
    source.write(b"after", Tsc(2)).unwrap();
    assert_eq!(read(&mut destination, &mut buffer, 2).unwrap().bytes, b"after");
}

#[test]
fn the_newest_stamp_is_that_of_what_would_be_read_and_counts_nothing() {
    let channel = Channel::new();
    let mut source = channel.source();
    source.write(b"before", Tsc(1)).unwrap();
    let mut destination = channel.destination();
    assert_eq!(destination.newest_stamp(), Err(ReadError::NeverWritten));
    for stamp in [2, 3, 3] {
        source.write(b"after", Tsc(stamp)).unwrap();
        assert_eq!(destination.newest_stamp(), Ok(Tsc(stamp)));
    }
    let before = destination.status();
    channel.region.poke(offset::WRITTEN, 1 << 63);
    assert!(matches!(destination.newest_stamp(), Err(ReadError::Hostile(_))));
    assert_eq!(destination.status(), before);
}

#[test]
fn opening_the_source_empties_the_channel() {
    let channel = Channel::new();
    let mut destination = channel.destination();
    channel.source().write(b"before", Tsc(1)).unwrap();
    let mut source = channel.source();
    let mut buffer = [0; MAXIMUM];
    assert_eq!(read(&mut destination, &mut buffer, 1), Err(ReadError::NeverWritten));
    source.write(b"after", Tsc(2)).unwrap();
    assert_eq!(read(&mut destination, &mut buffer, 2).unwrap().bytes, b"after");
    let status = destination.status();
    assert_eq!((status.peer_epoch, status.counters.peer_starts), (2, 1), "two starts, one look");
}

#[test]
fn a_reader_that_is_put_off_takes_no_honest_message_for_one_from_the_future() {
    let channel = Channel::new();
    let mut destination = channel.destination();
    let mut source = channel.source();
    source.write(b"before", Tsc(1_000)).unwrap();
    let mut buffer = [0; MAXIMUM];
    // The clock is read when all that could come has come.
    let late = || {
        source.write(b"after", Tsc(9_000)).unwrap();
        Tsc(1_050)
    };
    let sample = destination.read_by(&mut buffer, late).unwrap();
    assert_eq!((sample.bytes, sample.age), (&b"before"[..], Ticks(50)));
    assert_eq!(sample.validity, Validity::Valid);
    assert_eq!(destination.status().counters.hostile, 0);
}

#[test]
fn writing_an_empty_message_is_invalid_param() {
    let error = Channel::new().source().write(b"", Tsc(1)).unwrap_err();
    assert_eq!((error, error.code()), (LengthError::Empty, ReturnCode::InvalidParam));
}

#[test]
fn writing_more_than_the_maximum_is_invalid_config() {
    let channel = Channel::new();
    let mut destination = channel.destination();
    let error = channel.source().write(&[1; MAXIMUM + 1], Tsc(1)).unwrap_err();
    let expected = LengthError::TooLong { length: MAXIMUM + 1, maximum: MAXIMUM };
    assert_eq!((error, error.code()), (expected, ReturnCode::InvalidConfig));
    assert_eq!(read(&mut destination, &mut [0; MAXIMUM], 1), Err(ReadError::NeverWritten));
}

#[test]
fn every_length_up_to_the_maximum_succeeds() {
    let channel = Channel::new();
    let (mut source, mut destination) = (channel.source(), channel.destination());
    for length in 1..=MAXIMUM {
        let message: Vec<u8> = (1..=length as u8).collect();
        source.write(&message, Tsc(1)).unwrap();
        let mut buffer = [0xee; MAXIMUM];
        assert_eq!(read(&mut destination, &mut buffer, 1).unwrap().bytes, message);
        assert!(buffer[length..].iter().all(|&b| b == 0xee), "{length}");
    }
}

#[test]
fn the_last_word_of_a_message_is_filled_with_zeros() {
    let channel = Channel::new();
    let mut source = channel.source();
    for _ in 0..2 * channel.geometry.slots() {
        source.write(&[0xff; MAXIMUM], Tsc(1)).unwrap();
    }
    source.write(b"x", Tsc(1)).unwrap();
    let slot = channel.region.peek(offset::WRITTEN).wrapping_sub(1) as usize
        % channel.geometry.slots() as usize;
    let start = offset::SLOT + slot * channel.geometry.slot_bytes();
    assert_eq!(channel.region.peek(start + offset::PAYLOAD), u64::from(b'x'));
}

#[test]
fn a_port_never_written_is_no_action_and_invalid() {
    let channel = Channel::new();
    let mut destination = channel.destination();
    let error = read(&mut destination, &mut [0; MAXIMUM], 1).unwrap_err();
    assert_eq!((error, error.code()), (ReadError::NeverWritten, ReturnCode::NoAction));
    assert_eq!(destination.status().validity, Validity::Invalid);
}

#[test]
fn valid_is_exactly_an_age_of_at_most_the_refresh_period() {
    let channel = Channel::new();
    let (mut source, mut destination) = (channel.source(), channel.destination());
    source.write(b"x", Tsc(1000)).unwrap();
    for (now, age, validity) in [
        (1000, 0, Validity::Valid),
        (1100, 100, Validity::Valid),
        (1101, 101, Validity::Invalid),
        (u64::MAX, u64::MAX - 1000, Validity::Invalid),
    ] {
        let mut buffer = [0; MAXIMUM];
        let sample = read(&mut destination, &mut buffer, now).unwrap();
        assert_eq!((sample.age, sample.validity), (Ticks(age), validity), "{now}");
    }
}

#[test]
fn a_stamp_in_the_far_future_is_invalid_and_counted() {
    let channel = Channel::new();
    let (mut source, mut destination) = (channel.source(), channel.destination());
    source.write(b"x", Tsc(1000)).unwrap();
    let mut buffer = [0; MAXIMUM];
    assert_eq!(read(&mut destination, &mut buffer, 900).unwrap().validity, Validity::Valid);
    assert_eq!(destination.status().counters.hostile, 0);
    assert_eq!(read(&mut destination, &mut buffer, 899).unwrap().validity, Validity::Invalid);
    assert_eq!(destination.status().counters.hostile, 1);
}

#[test]
fn stale_data_is_still_returned() {
    let channel = Channel::new();
    let (mut source, mut destination) = (channel.source(), channel.destination());
    source.write(b"old", Tsc(1)).unwrap();
    let mut buffer = [0; MAXIMUM];
    let sample = read(&mut destination, &mut buffer, 1_000_000).unwrap();
    assert_eq!((sample.bytes, sample.validity), (&b"old"[..], Validity::Invalid));
}

#[test]
fn reading_does_not_consume() {
    let channel = Channel::new();
    let (mut source, mut destination) = (channel.source(), channel.destination());
    source.write(b"x", Tsc(1)).unwrap();
    for _ in 0..10 {
        assert_eq!(read(&mut destination, &mut [0; MAXIMUM], 1).unwrap().bytes, b"x");
    }
}

#[test]
fn the_newest_message_wins_at_every_destination() {
    let channel = Channel::new();
    let (mut source, mut one, mut two) =
        (channel.source(), channel.destination(), channel.destination());
    for n in 0..50_u8 {
        source.write(&[n], Tsc(n.into())).unwrap();
        assert_eq!(read(&mut one, &mut [0; MAXIMUM], 50).unwrap().bytes, [n]);
        if n % 7 == 0 {
            assert_eq!(read(&mut two, &mut [0; MAXIMUM], 50).unwrap().bytes, [n]);
        }
    }
}

#[test]
fn status_gives_the_validity_of_the_last_read() {
    let channel = Channel::new();
    let (mut source, mut destination) = (channel.source(), channel.destination());
    assert_eq!(destination.status().validity, Validity::Invalid);
    source.write(b"x", Tsc(1)).unwrap();
    assert_eq!(destination.status().validity, Validity::Invalid, "not read yet");
    read(&mut destination, &mut [0; MAXIMUM], 1).unwrap();
    assert_eq!(destination.status().validity, Validity::Valid);
    read(&mut destination, &mut [0; MAXIMUM], 1000).unwrap();
    let status = destination.status();
    assert_eq!(status.validity, Validity::Invalid);
    assert_eq!((status.maximum, status.refresh, status.peer_epoch), (MAXIMUM, REFRESH, 1));
}

#[test]
fn a_buffer_below_the_maximum_is_invalid_param() {
    let channel = Channel::new();
    channel.source().write(b"x", Tsc(1)).unwrap();
    let error = channel.destination().read(&mut [0; MAXIMUM - 1], Tsc(1)).unwrap_err();
    assert_eq!((error, error.code()), (ReadError::Buffer(MAXIMUM), ReturnCode::InvalidParam));
}
