//! Target of the frame decoder.

use r4_protocol::{
    FrameDecoder, FrameError, Request, ToDevice, ToHost, encode_frame,
    frame::{MAX_FRAME, Message},
};

/// Target: decodes any bytes. A decoded message can be sent again, and the good frame behind a delimiter is decoded.
///
/// # Panics
/// One of these is not so.
pub fn frames(bytes: &[u8]) -> bool {
    let to_device = direction(bytes, &ToDevice::Request { seq: 7, request: Request::Stats });
    let to_host = direction(bytes, &ToHost::Response { seq: 7, result: Ok(r4_protocol::Reply::Done) });
    to_device || to_host
}

fn direction<T: Message>(bytes: &[u8], good: &T) -> bool {
    let mut decoder = FrameDecoder::new();
    let mut taken = 0;
    for byte in bytes {
        match decoder.push::<T>(*byte) {
            Some(Ok(message)) => {
                taken += 1;
                comes_back(&message);
            }
            Some(Err(FrameError::Checksum { received, calculated })) => assert_ne!(received, calculated),
            Some(Err(_)) | None => {}
        }
    }
    // Ends a frame that is not complete.
    let _ = decoder.push::<T>(0);
    let mut buffer = [0; MAX_FRAME];
    let frame = encode_frame(good, &mut buffer).expect("a small message");
    let heard: Vec<_> = frame.iter().filter_map(|byte| decoder.push::<T>(*byte)).collect();
    assert!(matches!(heard[..], [Ok(_)]), "a good frame behind a delimiter is lost");
    taken > 0
}

/// Checks that a decoded message, encoded again, is decoded to the same. The input's bytes may differ: postcard accepts
/// numbers written with more bytes than they need.
fn comes_back<T: Message>(message: &T) {
    let (mut first, mut second) = ([0; MAX_FRAME], [0; MAX_FRAME]);
    let sent = encode_frame(message, &mut first).expect("no longer than what it came from");
    let mut decoder = FrameDecoder::new();
    let heard: Vec<_> = sent.iter().filter_map(|byte| decoder.push::<T>(*byte)).collect();
    let [Ok(again)] = &heard[..] else { panic!("{} messages of one", heard.len()) };
    assert_eq!(encode_frame(again, &mut second), Ok(sent));
}
