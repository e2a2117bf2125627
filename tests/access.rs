//! Tests of a guarded board: keys, tokens, refusals and the log, as their users see them.
#![cfg(unix)]

use std::{fs, path::Path};

use tempfile::TempDir;

use crate::program::{Running, all_refused, command, good, good_json, next, object, path, r4, start, text};

/// Output of a run that must succeed, and may say more on stderr.
fn printed(arguments: &[&str]) -> String {
    let seen = r4(arguments);
    assert!(seen.code == Some(0), "{arguments:?}: {seen:?}");
    seen.out
}

/// Folder with a policy for alice and her key.
fn ward(folder: &TempDir) -> (String, String) {
    let file = |name: &str| path(&folder.path().join(name)).to_owned();
    let (policy, key) = (file("ward.toml"), file("alice.toml"));
    let table = printed(&["access", "key", "alice", "--policy", "ward", "--purpose", "operation", "--out", &key]);
    let rules = "name = \"ward\"\n[token]\nskew_s = 0\n[[item]]\nresource = \"board\"\npurposes = [\"operation\"]\n\
                 [[item]]\nresource = \"channel\"\npurposes = [\"operation\"]\n\
                 [[rule]]\nroles = [\"operator\"]\nactions = [\"arm\", \"read\"]\nresources = [\"board\", \"channel\"]\n\
                 [[rule]]\nroles = [\"operator\"]\nactions = [\"set\"]\nresources = [\"channel/osmc0\"]\n";
    fs::write(&policy, rules.to_owned() + &table.replace("roles = []", "roles = [\"operator\"]")).expect("written");
    (policy, key)
}

/// The policy of docs/access.md with keys in place of its ellipses, and the file of alice's.
fn of_the_page(folder: &TempDir) -> (String, String) {
    let file = |name: &str| path(&folder.path().join(name)).to_owned();
    let page = fs::read_to_string(concat!(env!("CARGO_MANIFEST_DIR"), "/../../docs/access.md")).expect("a page");
    let block = page.split("```toml\n").nth(1).and_then(|rest| rest.split("```").next()).expect("a policy");
    let mut policy = block.to_owned();
    for (name, purpose) in [("alice", "operation"), ("nora", "care")] {
        let key = file(&format!("{name}.toml"));
        let table = printed(&["access", "key", name, "--policy", "ward-3", "--purpose", purpose, "--out", &key]);
        let digits = table.split("key = \"").nth(1).and_then(|rest| rest.split('"').next()).expect("a key");
        policy = policy.replacen('\u{2026}', digits, 1);
    }
    fs::write(file("ward-3.toml"), policy).expect("written");
    (file("ward-3.toml"), file("alice.toml"))
}

fn served(policy: &str) -> (Running, String) {
    let server = start(command(&["serve", "sim:osmc-bench", "--tcp", "127.0.0.1:0", "--policy", policy]));
    let first = object(&next(server.out.as_ref().expect("stdout"), server.begin).expect("a first line"));
    let board = format!("tcp:{}", text(&first, "tcp"));
    (server, board)
}

#[test]
fn a_policy_decides_who_moves_the_board() {
    let folder = TempDir::new().expect("a folder");
    let (policy, key) = ward(&folder);
    let (server, board) = served(&policy);
    let on_board = |arguments: &[&str]| r4(&[&["--board", &board], arguments].concat());
    let moved = on_board(&["--token", &key, "move", "osmc0", "5deg"]);
    assert_eq!(moved.code, Some(0), "{moved:?}");
    // Another channel, and no token: refused with the next step. Disarming needs no token.
    for arguments in [&["--token", &key, "move", "actuator1", "10mm"][..], &["move", "osmc0", "5deg"], &["faults"]] {
        let refused = on_board(arguments);
        assert!(refused.code == Some(3) && refused.err.contains("--token or R4_TOKEN"), "{arguments:?}: {refused:?}");
    }
    assert_eq!(on_board(&["disarm"]).code, Some(0));
    // A token for one connection: the second finds it used.
    let token = folder.path().join("token");
    fs::write(&token, printed(&["access", "grant", &key])).expect("written");
    fs::set_permissions(&token, std::os::unix::fs::PermissionsExt::from_mode(0o600)).expect("for the owner alone");
    let once = |code| {
        let seen = on_board(&["--token", path(&token), "move", "osmc0", "0deg"]);
        assert_eq!(seen.code, Some(code), "{seen:?}");
    };
    once(0);
    once(3);
    drop(server);
    the_log_is_verified(Path::new(&policy));
}

/// Checks the log of the test above, and that a cut one is found.
/// A reader of docs/access.md who copies its policy moves a motor.
#[test]
fn the_policy_of_the_page_is_one() {
    let folder = TempDir::new().expect("a folder");
    let (policy, key) = of_the_page(&folder);
    let asked = ["access", "check", &policy, "set", "channel/osmc0", "--as", "alice", "--purpose", "operation"];
    assert!(printed(&asked).contains("granted"));
    let (server, board) = served(&policy);
    let moved = r4(&["move", "osmc0", "90deg", "--board", &board, "--token", &key]);
    assert_eq!(moved.code, Some(0), "{moved:?}");
    printed(&["access", "grant", path(&folder.path().join("nora.toml")), "--emergency"]);
    drop(server);
}

fn the_log_is_verified(policy: &Path) {
    let log = format!("{}.log", policy.display());
    let shown = good(&["access", "log", &log]);
    for part in ["alice: set channel/osmc0: granted", "alice: set channel/actuator1: denied", "presented before"] {
        assert!(shown.contains(part), "{part}: {shown}");
    }
    let head = format!("{log}.head");
    let entries = good_json(&["access", "log", &log, "--json", "--anchor", &head]);
    assert!(entries["entries"].as_array().expect("entries").len() > 5, "{entries:#}");
    let whole = fs::read_to_string(&log).expect("a log");
    let cut = whole.trim_end().rfind('\n').expect("lines") + 1;
    fs::write(&log, &whole[..cut]).expect("written");
    let seen = r4(&["access", "log", &log]);
    assert!(seen.code == Some(1) && seen.err.contains("were cut off"), "{seen:?}");
    // Nor does a guard start on it.
    let policy = path(policy);
    let seen = r4(&["serve", "sim:osmc-bench", "--tcp", "127.0.0.1:0", "--policy", policy]);
    assert!(seen.code == Some(1) && seen.err.contains("evidence"), "{seen:?}");
}

#[test]
fn a_check_gives_the_reason() {
    let folder = TempDir::new().expect("a folder");
    let (policy, _) = ward(&folder);
    let check = |arguments: &[&str]| r4(&[&["access", "check", &policy], arguments].concat());
    for (arguments, code, says) in [
        (&["set", "channel/osmc0", "--as", "alice", "--purpose", "operation"][..], 0, "granted"),
        (&["set", "channel/osmc1", "--as", "alice", "--purpose", "operation"], 1, "no [[rule]]"),
        (&["set", "channel/osmc0", "--as", "alice", "--purpose", "show"], 1, "purpose"),
        (&["set", "channel/osmc0"], 1, "no valid token"),
        (&["read", "log", "--as", "alice", "--purpose", "operation"], 1, "no [[item]]"),
    ] {
        let seen = check(arguments);
        assert!(seen.code == Some(code) && seen.out.contains(says), "{arguments:?}: {seen:?}");
    }
    let bad = folder.path().join("bad.toml");
    fs::write(&bad, "name = \"ward\"\n[token]\nlife_s = 1\n").expect("written");
    let bad = path(&bad);
    all_refused([
        (&["access", "check", &policy, "stop", "board"][..], &["never refused"][..]),
        (&["access", "check", &policy, "read", "wing"], &["no resource"]),
        (&["access", "check", &policy, "read", "log", "--as", "bob"], &["it has alice"]),
        (&["access", "check", bad, "read", "log"], &["line 3", "10 to 3600"]),
        (&["serve", "sim:osmc-bench", "--policy", bad], &["line 3"]),
        (&["serve", "sim:osmc-bench", "--policy", bad, "--http"], &["cannot be used with"]),
        (&["--token", bad, "--board", "tcp:127.0.0.1:9", "info"], &["chmod 600"]),
    ]);
}
