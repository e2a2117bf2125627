//! Tests of every target with its stored corpus and with seeded neighbours of it: the same inputs each time, about 20 s
//! of them.
//!
//! For more of them, and other ones: `R4_FUZZ_RUNS=1000000 R4_FUZZ_SEED=7 cargo test --release -p r4-fuzz --test replay
//! dispatcher`.
#![allow(clippy::unwrap_used, reason = "test code")]

use std::{
    env, fs,
    panic::{AssertUnwindSafe, catch_unwind, resume_unwind},
    path::{Path, PathBuf},
    time::Instant,
};

use r4_fuzz::{TARGETS, Target, mutate::Mutator};
use r4_protocol::{FrameDecoder, Request, SCHEMA_HASH, ToDevice, VERSION};

/// Returns the inputs of a target: its corpus, and suitable files of the project.
fn seeds(name: &str) -> Vec<Vec<u8>> {
    let here = Path::new(env!("CARGO_MANIFEST_DIR"));
    let more: &[&str] = match name {
        "robot" => &["../../boards"],
        "plant" => &["../../boards/plants"],
        "scenario" => &["../scenarios"],
        _ => &[],
    };
    let corpus = here.join("corpus").join(name);
    let folders = [corpus].into_iter().chain(more.iter().map(|folder| here.join(folder)));
    let mut files: Vec<PathBuf> = folders
        .flat_map(|folder| fs::read_dir(&folder).unwrap_or_else(|why| panic!("{}: {why}", folder.display())))
        .map(|entry| entry.unwrap().path())
        .filter(|path| {
            path.is_file() && path.extension().is_none_or(|extension| extension != "rs" && extension != "md")
        })
        .filter(|path| path.file_name().is_some_and(|name| name != "Cargo.toml"))
        .collect();
    files.sort();
    files.iter().map(|path| fs::read(path).unwrap()).collect()
}

/// Runs the target `name` on its corpus and on `runs` neighbours.
fn replay(name: &str, runs: usize) {
    let number = |variable| env::var(variable).ok().map(|text| text.parse().unwrap());
    let runs = number("R4_FUZZ_RUNS").unwrap_or(runs as u64);
    let mut mutator = Mutator::new(number("R4_FUZZ_SEED").unwrap_or(1));
    let (_, target) = TARGETS.into_iter().find(|(of, _)| *of == name).unwrap();
    let seeds = seeds(name);
    let start = Instant::now();
    let whole = seeds.iter().filter(|seed| try_it(name, target, seed)).count();
    let mut taken = 0;
    for _ in 0..runs {
        let (seed, other) = (&seeds[mutator.below(seeds.len())], &seeds[mutator.below(seeds.len())]);
        let input = mutator.neighbour(seed, other);
        taken += u64::from(try_it(name, target, &input));
    }
    println!(
        "{name}: {whole} of {} seeds and {taken} of {runs} neighbours taken, {:.1?}",
        seeds.len(),
        start.elapsed()
    );
    assert!(whole > 0, "a corpus of which nothing is taken tests nothing");
    assert!(taken > 0 && taken < runs, "neighbours are near: some are taken and some not");
}

/// Runs the target on one input; an input that fails is kept, and its path printed.
fn try_it(name: &str, target: Target, input: &[u8]) -> bool {
    catch_unwind(AssertUnwindSafe(|| target(input))).unwrap_or_else(|why| {
        let kept = Path::new(env!("CARGO_TARGET_TMPDIR")).join(format!("{name}.failed"));
        fs::write(&kept, input).unwrap();
        eprintln!("{name}: this input fails: {}", kept.display());
        resume_unwind(why)
    })
}

/// A corpus of another protocol version would be refused at its first message, and nothing behind that would be tested.
#[test]
fn the_corpus_is_of_this_protocol() {
    let said = fs::read(Path::new(env!("CARGO_MANIFEST_DIR")).join("corpus/link/hello")).unwrap();
    let mut decoder = FrameDecoder::new();
    let hello = said.iter().find_map(|byte| decoder.push::<ToDevice>(*byte)).and_then(Result::ok);
    let ours = Request::Hello { version: VERSION, schema: SCHEMA_HASH };
    let is_ours = matches!(hello, Some(ToDevice::Request { ref request, .. }) if *request == ours);
    assert!(is_ours, "write it anew: cargo run -p r4-fuzz --example seeds; it says {hello:?}");
}

macro_rules! replays {
    ($($name:ident $runs:literal)*) => {
        $(#[test] fn $name() { replay(stringify!($name), $runs); })*

        #[test]
        fn every_target_is_replayed() {
            let replayed = [$(stringify!($name)),*];
            assert_eq!(TARGETS.map(|(name, _)| name)[..], replayed[..]);
        }
    };
}

replays! {
    carrier 1000
    config 5000
    dispatcher 800
    driver 5000
    flash 5000
    frames 20000
    key 1000
    legacy 20000
    link 800
    log 5000
    page 20000
    plant 8000
    recording 3000
    robot 2000
    scenario 5000
    secure 3000
    slcan 20000
    tap 5000
}
