//! Target of the encrypted link, with an attacker between its two ends.

use std::{io, os::unix::net::UnixStream};

use embedded_io_async::{Read, Write};
use futures::future::join3;
use r4_links::{
    Descriptor, Key, block_on,
    secure::{self, HANDSHAKE},
};

use crate::mutate::Mutator;

/// Pieces that the client sends.
const SENT: [&[u8]; 4] = [b"a first record", b"", b"another one, which is longer than the first", &[0; 600]];

/// Target: an input describes the attacker. Its first byte chooses the part of the conversation (the client's message
/// of the handshake, the server's, the records), the rest the changes; no rest leaves that part unchanged. Whatever the
/// input, the far end reads only what was sent, up to the first change, and a changed handshake opens no link.
///
/// # Panics
/// The far end reads something else, or accepts a changed handshake.
pub fn secure(bytes: &[u8]) -> bool {
    let (what, how) = bytes.split_first().map_or((2, &[][..]), |(what, how)| (what % 3, how));
    let (client_end, to_client) = pair().expect("a pair of sockets");
    let (server_end, to_server) = pair().expect("a pair of sockets");
    let key = Key::new([0x5A; 32]);
    // `all`: everything passed unchanged; `greeting`: so did the part of the handshake that each end waits for.
    let (mut all, mut greeting) = (true, true);
    let between = async {
        let mut change = |part: u8, bytes: Vec<u8>| {
            let passed_on = if part == what { touched(&bytes, how) } else { bytes.clone() };
            all &= passed_on == bytes;
            greeting &= part == 2 || passed_on.starts_with(&bytes);
            // Ends the test, because the far end would wait for the rest indefinitely.
            if part < 2 && passed_on.len() < bytes.len() { Err(io::ErrorKind::UnexpectedEof) } else { Ok(passed_on) }
        };
        let (mut client, mut server) = (to_client, to_server);
        let first = change(0, exactly(&mut client, HANDSHAKE).await?)?;
        server.write_all(&first).await?;
        let answer = change(1, exactly(&mut server, HANDSHAKE).await?)?;
        client.write_all(&answer).await?;
        let mut records = Vec::new();
        let mut buffer = [0; 1024];
        while let len @ 1.. = client.read(&mut buffer).await? {
            records.extend_from_slice(&buffer[..len]);
        }
        // The server may have closed the connection at the first record that it does not trust.
        let _ = server.write_all(&change(2, records)?).await;
        Ok::<_, io::Error>(())
    };
    let client = async {
        let (_rx, mut tx) = secure::client(client_end, &key).await?;
        for piece in SENT {
            tx.write_all(piece).await?;
        }
        Ok::<_, io::Error>(())
    };
    let server = async {
        let (mut rx, _tx) = secure::server(server_end, &key).await?;
        let mut read = Vec::new();
        let mut buffer = [0; 64];
        loop {
            match rx.read(&mut buffer).await {
                Ok(0) => return Ok::<_, io::Error>((read, true)),
                Ok(len) => read.extend_from_slice(&buffer[..len]),
                Err(_) => return Ok((read, false)),
            }
        }
    };
    let (client, server, _) = block_on(join3(client, server, between));
    let sent = SENT.concat();
    // The server verifies the client's message, and without its answer there is no link; the client verifies the
    // server's.
    assert!(greeting || client.is_err(), "the client trusts what was changed on the way");
    assert!(greeting || what == 1 || server.is_err(), "the server trusts what was changed on the way");
    let (read, to_the_end) = server.unwrap_or_default();
    assert!(sent.starts_with(&read), "the server read what the client has not sent");
    assert!(!all || (client.is_ok() && read == sent && to_the_end), "nobody touched anything");
    all
}

fn pair() -> io::Result<(Descriptor, Descriptor)> {
    let (a, b) = UnixStream::pair()?;
    Ok((Descriptor::new(a.into())?, Descriptor::new(b.into())?))
}

async fn exactly(link: &mut Descriptor, len: usize) -> io::Result<Vec<u8>> {
    let mut bytes = vec![0; len];
    link.read_exact(&mut bytes).await.map_err(|_| io::ErrorKind::UnexpectedEof)?;
    Ok(bytes)
}

/// Returns `bytes` with one change for each three bytes of `how`.
fn touched(bytes: &[u8], how: &[u8]) -> Vec<u8> {
    let mut bytes = bytes.to_vec();
    for [kind, at, value] in how.as_chunks().0 {
        let at = (usize::from(*at) * 257 + usize::from(*value)) % bytes.len().max(1);
        match kind % 4 {
            0 => bytes.iter_mut().skip(at).take(1).for_each(|byte| *byte ^= value),
            1 => bytes.truncate(at),
            2 => bytes.insert(at.min(bytes.len()), *value),
            // A part of the bytes is inserted again, or replaces another part.
            _ => {
                let from = Mutator::new(u64::from(*value)).below(bytes.len());
                let again = bytes[from..].to_vec();
                bytes.splice(at.min(bytes.len()).., again);
            }
        }
    }
    bytes
}
