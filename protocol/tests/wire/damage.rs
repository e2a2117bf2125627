//! Damage of a link to frames, which a decoder must survive.
//!
//! The checksum guarantees: CRC-16 with polynomial 0x1021 detects every one, two or three wrong bits in up to 32751
//! bits, and every error within 16 bits in a row (Koopman, "Best CRC Polynomials", 0x8810). It covers the message
//! before COBS, so the guarantee holds for bytes on the wire as long as COBS leaves them in place. A damaged COBS code
//! moves zeros, a new 0x00 cuts the frame in two, and one wrong bit on the wire becomes many in the message. These are
//! detected too, but for one in 2^16 of those that COBS and postcard let through. Of commands, whose checksum has 32
//! bits, none of the frames tried here and in `many` is taken.

use proptest::{
    arbitrary::any,
    collection::vec,
    prelude::{ProptestConfig, Strategy},
    prop_assert, prop_assert_eq, prop_assume, prop_oneof, proptest,
    sample::Index,
    strategy::ValueTree,
    test_runner::TestRunner,
};
use r4_protocol::{
    FrameError, ToDevice, ToHost,
    frame::{Check, Message},
};
use serde::{Serialize, Serializer, ser::SerializeTuple};

use crate::{frame, gives_back, payload, raw, receive, samples, strategies};

proptest! {
    #![proptest_config(ProptestConfig::with_cases(1024))]

    #[test]
    fn any_message_comes_back(to_device in strategies::to_device(), to_host in strategies::to_host()) {
        prop_assert!(gives_back(&frame(&to_device), &to_device));
        prop_assert!(gives_back(&frame(&to_host), &to_host));
    }

    #[test]
    fn up_to_three_wrong_bits_that_cobs_leaves_in_place_fail_the_checksum(
        message in strategies::to_host(),
        flips in vec((any::<Index>(), 0..8u8), 1..=3),
    ) {
        let good = frame(&message);
        let places = data_places(&good);
        let mut bad = good.clone();
        flips.iter().for_each(|(place, bit)| bad[*place.get(&places)] ^= 1 << bit);
        // Flips that cancel each other, or make a delimiter, are no damage of this kind.
        prop_assume!(bad != good && !bad[..bad.len() - 1].contains(&0));
        prop_assert!(fails_the_checksum(&bad));
    }

    /// Tries the guarantee for 16 bits in a row, on whole bytes: two neighbours of the message or the checksum.
    #[test]
    fn any_change_of_two_neighbours_that_cobs_leaves_in_place_fails_the_checksum(
        message in strategies::to_host(),
        place in any::<Index>(),
        change in 1..=u16::MAX,
    ) {
        let good = frame(&message);
        let places = data_places(&good);
        // Places are apart where a COBS code lies between.
        let neighbours: Vec<_> = places.windows(2).filter(|pair| pair[0] + 1 == pair[1]).collect();
        prop_assume!(!neighbours.is_empty());
        let pair = place.get(&neighbours);
        let mut bad = good.clone();
        change.to_be_bytes().iter().zip(*pair).for_each(|(bits, place)| bad[*place] ^= bits);
        prop_assume!(!bad[..bad.len() - 1].contains(&0));
        prop_assert!(fails_the_checksum(&bad));
    }

    /// Cuts a frame: it runs into the next one, which is lost with it. The one after is taken.
    #[test]
    fn a_cut_frame_costs_at_most_the_next_one(
        first in strategies::to_device(),
        second in strategies::to_device(),
        third in strategies::to_device(),
        cut in any::<Index>(),
    ) {
        let (first, second) = (frame(&first), frame(&second));
        let cut = cut.index(first.len());
        let end_lost = receive::<ToDevice>(&[&first[..cut], &second, &frame(&third)].concat());
        prop_assert_eq!(end_lost.len(), 2);
        prop_assert!(is(end_lost.last(), &third));
        let start_lost = receive::<ToDevice>(&[&first[cut..], &second, &frame(&third)].concat());
        // A delimiter alone is no frame.
        prop_assert_eq!(start_lost.len(), if cut == first.len() - 1 { 2 } else { 3 });
        prop_assert!(is(start_lost.last(), &third));
    }

    #[test]
    fn a_damaged_delimiter_costs_two_frames(
        first in strategies::to_device(),
        second in strategies::to_device(),
        third in strategies::to_device(),
        bit in 0..8u8,
    ) {
        let mut bytes = frame(&first);
        *bytes.last_mut().expect("a frame has bytes") ^= 1 << bit;
        bytes.extend(frame(&second));
        bytes.extend(frame(&third));
        let received = receive::<ToDevice>(&bytes);
        prop_assert_eq!(received.len(), 2);
        prop_assert!(is(received.last(), &third));
    }

    /// Puts any bytes between two frames, up to the delimiter that ends them.
    #[test]
    fn garbage_between_frames_costs_no_frame_after_its_delimiter(
        before in strategies::to_device(),
        after in strategies::to_device(),
        garbage in vec(any::<u8>(), 0..600),
    ) {
        let received = receive::<ToDevice>(&[&frame(&before)[..], &garbage, &[0], &frame(&after)].concat());
        prop_assert!(is(received.first(), &before));
        prop_assert!(is(received.last(), &after));
    }

    /// Checks that a frame is decoded from its own bytes: the decoder keeps nothing of earlier ones.
    #[test]
    fn one_decoder_makes_of_a_stream_what_fresh_ones_make_of_its_pieces(
        pieces in vec(
            prop_oneof![
                strategies::to_host().prop_map(|message| frame(&message)),
                vec(any::<u8>(), 0..300).prop_map(|mut garbage| { garbage.push(0); garbage }),
            ],
            0..8,
        ),
    ) {
        let stream = receive::<ToHost>(&pieces.concat());
        let apart: Vec<_> = pieces.iter().flat_map(|piece| receive::<ToHost>(piece)).collect();
        // Compared as text, because a NaN is not equal to itself.
        prop_assert_eq!(format!("{stream:?}"), format!("{apart:?}"));
    }

    /// Tries random bytes with a correct checksum, which reach postcard. A message that it accepts can be sent again.
    #[test]
    fn any_undamaged_bytes_are_survived(bytes in vec(prop_oneof![0..16u8, any::<u8>()], 0..=248)) {
        survives::<ToDevice>(&bytes);
        survives::<ToHost>(&bytes);
    }

    /// Tries the neighbours of a message: one byte of it is replaced.
    #[test]
    fn any_undamaged_neighbour_of_a_message_is_survived(
        message in strategies::to_host(),
        place in any::<Index>(),
        byte in any::<u8>(),
    ) {
        let mut bytes = payload(&message);
        *place.get_mut(&mut bytes) = byte;
        survives::<ToHost>(&bytes);
    }
}

#[test]
fn one_wrong_bit_in_any_golden_frame_is_not_taken() {
    fn check<T: Message>(name: &str, message: &T) {
        let good = frame(message);
        for bit in 0..8 * (good.len() - 1) {
            let mut bad = good.clone();
            bad[bit / 8] ^= 1 << (bit % 8);
            assert!(receive::<T>(&bad).iter().all(Result::is_err), "{name} with bit {bit} wrong: {bad:02x?}");
        }
    }
    samples::to_device().iter().for_each(|(name, message)| check(name, message));
    samples::to_host().iter().for_each(|(name, message)| check(name, message));
}

/// Tries the rest of the guarantee, for one to three wrong bits anywhere in a frame, COBS codes and new delimiters
/// included. Seeded, so that the frames are the same each time.
#[test]
fn fewer_than_one_in_65536_frames_with_up_to_three_wrong_bits_is_taken() {
    const TRIED: usize = 1 << 18;
    let mut runner = TestRunner::deterministic();
    let flips = vec(any::<Index>(), 3);
    let mut taken = 0;
    for _ in 0..TRIED / 64 {
        let good = frame(&strategies::to_device().new_tree(&mut runner).expect("no filters").current());
        for _ in 0..64 {
            let flips = flips.new_tree(&mut runner).expect("no filters").current();
            let mut bad = good.clone();
            for flip in flips {
                let bit = flip.index(8 * (good.len() - 1));
                bad[bit / 8] ^= 1 << (bit % 8);
            }
            // Two flips of one bit leave one wrong, never none.
            taken += usize::from(receive::<ToDevice>(&bad).iter().any(Result::is_ok));
        }
    }
    assert!(taken < TRIED >> 16, "{taken} of {TRIED}");
}

/// Returns the places at which the frame holds a byte of the message or checksum unchanged: not a COBS code, not the
/// delimiter.
fn data_places(frame: &[u8]) -> Vec<usize> {
    let end = frame.len() - 1;
    let codes: Vec<_> = std::iter::successors(Some(0), |code| Some(code + usize::from(frame[*code])))
        .take_while(|code| *code < end)
        .collect();
    (0..end).filter(|place| !codes.contains(place)).collect()
}

fn fails_the_checksum(frame: &[u8]) -> bool {
    matches!(receive::<ToHost>(frame)[..], [Err(FrameError::Checksum { .. })])
}

fn is<T: Serialize>(received: Option<&Result<T, FrameError>>, message: &T) -> bool {
    matches!(received, Some(Ok(received)) if payload(received) == payload(message))
}

/// Checks that `bytes` in an undamaged frame are one message, which comes back when sent again, or `NotAMessage`.
///
/// # Panics
/// When they are anything else.
fn survives<T: Message>(bytes: &[u8]) {
    for check in [Check::Short, Check::Long] {
        match &receive::<T>(&raw(&Raw(bytes), check))[..] {
            // postcard takes numbers written with more bytes than they need, so the bytes may differ.
            [Ok(message)] => {
                assert!((check == Check::Long || message.check() == check) && gives_back(&frame(message), message));
            }
            [Err(error)] => assert!(matches!(error, FrameError::NotAMessage { .. }), "{error:?}"),
            other => panic!("one frame gave {} results", other.len()),
        }
    }
}

/// Bytes without a length before them.
struct Raw<'a>(&'a [u8]);

impl Serialize for Raw<'_> {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        let mut tuple = serializer.serialize_tuple(self.0.len())?;
        self.0.iter().try_for_each(|byte| tuple.serialize_element(byte))?;
        tuple.end()
    }
}
