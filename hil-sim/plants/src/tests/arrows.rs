//! Dependences between source files: no circle.

use std::{
    collections::{BTreeMap, BTreeSet},
    fs,
    path::Path,
};

/// Expands a `use` tree to paths: `a::{b, c::d}` becomes `a::b` and `a::c::d`.
fn paths(tree: &str, prefix: &str, found: &mut Vec<String>) {
    let (mut depth, mut start) = (0, 0);
    let mut parts = Vec::new();
    for (at, letter) in tree.char_indices() {
        match letter {
            '{' => depth += 1,
            '}' => depth -= 1,
            ',' if depth == 0 => {
                parts.push(&tree[start..at]);
                start = at + 1;
            }
            _ => {}
        }
    }
    parts.push(&tree[start..]);
    for part in parts.into_iter().map(str::trim).filter(|part| !part.is_empty()) {
        match part.split_once('{') {
            Some((head, rest)) => {
                paths(rest.trim_end().trim_end_matches('}'), &format!("{prefix}{}", head.trim()), found);
            }
            None => found.push(format!("{prefix}{part}")),
        }
    }
}

/// Modules (`effect::input`, `plant`; the root is empty), and those that each uses outside its unit tests.
fn uses() -> BTreeMap<String, BTreeSet<String>> {
    let source = Path::new(env!("CARGO_MANIFEST_DIR")).join("src");
    let mut texts = BTreeMap::new();
    for (folder, prefix) in [("", ""), ("effect", "effect::")] {
        for entry in fs::read_dir(source.join(folder)).unwrap() {
            let path = entry.unwrap().path();
            let Some(name) = path.file_name().unwrap().to_str().unwrap().strip_suffix(".rs").map(str::to_owned) else {
                continue;
            };
            let module = match name.as_str() {
                "lib" => String::new(),
                "mod" => prefix.trim_end_matches("::").to_owned(),
                name => format!("{prefix}{name}"),
            };
            let text = fs::read_to_string(&path).unwrap();
            let code = text.split("#[cfg(test)]\nmod tests {").next().unwrap();
            let code: Vec<_> = code.lines().filter(|line| !line.trim_start().starts_with("//")).collect();
            texts.insert(module, code.join(" "));
        }
    }
    let file_of = |path: &str| {
        let mut path = path;
        while !texts.contains_key(path) {
            path = path.rsplit_once("::").map_or("", |(head, _)| head);
        }
        path.to_owned()
    };
    let used_by = |module: &str, text: &str| {
        let mut found = Vec::new();
        for statement in text.split("use ").skip(1).filter_map(|rest| rest.split(';').next()) {
            paths(statement, "", &mut found);
        }
        let above = module.rsplit_once("::").map_or("", |(head, _)| head);
        let own = |path: &String| {
            let path = match (path.strip_prefix("crate::"), path.strip_prefix("super::")) {
                (Some(path), _) => path.to_owned(),
                (_, Some(path)) => format!("{above}::{path}"),
                _ if module.is_empty() => path.clone(),
                _ => format!("{module}::{path}"),
            };
            let head = path.split("::").next().unwrap();
            texts.contains_key(head).then(|| file_of(&path)).filter(|file| file != module)
        };
        found.iter().filter_map(own).collect()
    };
    texts.iter().map(|(module, text)| (module.clone(), used_by(module, text))).collect()
}

#[test]
fn files_use_each_other_one_way() {
    let mut uses = uses();
    // Check of the parser itself: these dependences exist.
    for (from, to) in [("plant", "spec"), ("text", "spec"), ("effect", "effect::input"), ("effect::input", "drive")] {
        assert!(uses[from].contains(to), "{from} uses {to}: {:?}", uses[from]);
    }
    // Removes leaves until none is left; a circle remains.
    loop {
        let leaves: BTreeSet<_> =
            uses.iter().filter(|(_, used)| used.is_empty()).map(|(file, _)| file.clone()).collect();
        if leaves.is_empty() {
            break;
        }
        uses.retain(|file, _| !leaves.contains(file));
        uses.values_mut().for_each(|used| used.retain(|file| !leaves.contains(file)));
    }
    assert!(uses.is_empty(), "these use each other in a circle: {uses:#?}");
}
