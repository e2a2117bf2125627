//! `r4 serve --http` as a user sees it: where the page is, and who gets it. The page itself is tested in `host/page`.

use std::{
    fs,
    io::{Read, Write},
    net::TcpStream,
    os::unix::fs::PermissionsExt,
};

use crate::program::*;

/// What is answered to a request for the page at `http`.
fn fetched(http: &str, host: &str) -> String {
    let at = http.trim_start_matches("http://").trim_end_matches('/');
    let mut stream = TcpStream::connect(at).expect("served");
    stream.write_all(format!("GET / HTTP/1.1\r\nHost: {host}\r\n\r\n").as_bytes()).expect("sent");
    let mut answer = String::new();
    stream.read_to_string(&mut answer).expect("text");
    answer
}

/// Starts a server of a page. Returns it with the page's address, and the address that it prints for people.
fn served(more: &[&str]) -> (Running, String, String) {
    let arguments = ["serve", "sim:osmc-bench", "--tcp", "127.0.0.1:0", "--http=127.0.0.1:0"];
    let server = start(command(&[&arguments, more].concat()));
    let first = object(&next(server.out.as_ref().expect("stdout"), server.begin).expect("a first line"));
    let told = std::iter::from_fn(|| next(&server.err, server.begin)).find(|line| line.contains("in a browser"));
    (server, text(&first, "http").to_owned(), told.expect("where to open it"))
}

#[test]
fn the_page_is_for_this_machine() {
    let (_server, http, told) = served(&[]);
    assert_eq!(told, format!("r4: open {http} in a browser"));
    let page = fetched(&http, "localhost");
    assert!(page.starts_with("HTTP/1.1 200 OK\r\n") && page.contains("<title>R4</title>"), "{page}");
    assert!(fetched(&http, "evil.example").starts_with("HTTP/1.1 403 "));
}

#[test]
fn with_a_key_what_is_behind_the_address_is_not_the_key() {
    let folder = tempfile::TempDir::new().expect("a folder");
    let key = folder.path().join("key");
    fs::write(&key, "5a".repeat(32)).expect("written");
    fs::set_permissions(&key, fs::Permissions::from_mode(0o600)).expect("for the owner alone");
    let (_server, http, told) = served(&["--key", key.to_str().expect("text")]);
    let token = told.split('#').nth(1).and_then(|rest| rest.split(' ').next()).expect("a token");
    assert!(token.len() == 64 && token != "5a".repeat(32), "{told}");
    // Other names of this machine are no matter.
    let page = fetched(&http, "robot.local");
    assert!(page.starts_with("HTTP/1.1 200 OK\r\n") && !page.contains(token), "{page}");
}

#[test]
fn other_machines_need_a_key() {
    all_refused([
        (
            &["serve", "sim:osmc-bench", "--tcp", "127.0.0.1:0", "--http=0.0.0.0:0"][..],
            &["from other machines", "--key"][..],
        ),
        (&["serve", "sim:osmc-bench", "--tcp", "127.0.0.1:0", "--http=0.0.0.0:0", "--public"], &["--key"]),
    ]);
}
