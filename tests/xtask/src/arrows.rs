//! Dependences between the source files of a crate: no circle, neither of files nor of the modules at the top.

use std::{
    collections::{BTreeMap, BTreeSet},
    fs,
    path::Path,
};

use syn::{
    Attribute, Item, ItemMod, ItemUse, UseTree,
    visit::{self, Visit},
};

/// Crates that are held to it, and for each some dependences that exist, as a check of the reading itself.
const CRATES: [(&str, &[(&str, &str)]); 2] = [
    ("hil-sim/plants", &[("plant", "spec"), ("text", "spec"), ("effect", "effect::input"), ("effect::input", "drive")]),
    (
        "firmware/core",
        // A tree of `use`, one of `super`, a re-export, a path in an expression.
        &[("link", "dispatch"), ("motion::axis", "motion::scurve"), ("", "shared"), ("control::model", "channel")],
    ),
];

/// For each file, as the path of its module (`effect::input`; empty for the crate's root), those that it uses.
type Uses = BTreeMap<String, BTreeSet<String>>;

/// Reads the source files in `folder`, whose module is `module`.
fn read(folder: &Path, module: &[String], files: &mut BTreeMap<String, syn::File>) {
    for entry in fs::read_dir(folder).unwrap() {
        let path = entry.unwrap().path();
        let stem = path.file_stem().unwrap().to_str().unwrap().to_owned();
        let inner = [module, std::slice::from_ref(&stem)].concat();
        if path.is_dir() {
            read(&path, &inner, files);
        } else if path.extension().is_some_and(|extension| extension == "rs") {
            let module = if stem == "mod" || stem == "lib" && module.is_empty() { module } else { &inner[..] };
            files.insert(module.join("::"), syn::parse_file(&fs::read_to_string(&path).unwrap()).unwrap());
        }
    }
}

fn is_for_tests(attributes: &[Attribute]) -> bool {
    let is_test = |attribute: &Attribute| {
        attribute.path().is_ident("cfg") && attribute.parse_args::<syn::Path>().is_ok_and(|path| path.is_ident("test"))
    };
    attributes.iter().any(is_test)
}

/// Removes the modules that are compiled for tests only.
fn without_tests(mut files: BTreeMap<String, syn::File>) -> BTreeMap<String, syn::File> {
    let mut removed = BTreeSet::new();
    for (module, file) in &files {
        for item in &file.items {
            if let Item::Mod(ItemMod { attrs, ident, content: None, .. }) = item
                && is_for_tests(attrs)
            {
                removed.insert(format!("{module}::{ident}").trim_start_matches("::").to_owned());
            }
        }
    }
    files.retain(|module, _| !removed.iter().any(|test| module == test || module.starts_with(&format!("{test}::"))));
    files
}

/// Collects the modules that one file uses.
struct Reader<'f> {
    files: &'f BTreeMap<String, syn::File>,
    /// Module at the present item: the file's, or one within it.
    module: Vec<String>,
    used: BTreeSet<String>,
}

impl Reader<'_> {
    /// Takes a path as it is written; one that leads out of the crate, or to what the module itself has, is no use.
    fn take(&mut self, path: &[String]) {
        let mut full = self.module.clone();
        let mut rest = path;
        match path.first().map(String::as_str) {
            Some("crate") => {
                full.clear();
                rest = &path[1..];
            }
            Some("self") => rest = &path[1..],
            Some("super") => {
                while let Some((_, behind)) = rest.split_first().filter(|(first, _)| *first == "super") {
                    full.pop();
                    rest = behind;
                }
            }
            // A path that begins with a name: of a module below, or of something imported, which counts where it is.
            Some(first) if self.has_below(first) => {}
            _ => return,
        }
        full.extend_from_slice(rest);
        while !self.files.contains_key(&full.join("::")) {
            full.pop();
        }
        self.used.insert(full.join("::"));
    }

    fn has_below(&self, name: &str) -> bool {
        self.files.contains_key(&[&self.module[..], &[name.to_owned()]].concat().join("::"))
    }

    fn take_tree(&mut self, tree: &UseTree, before: &[String]) {
        let with = |name: String| [before, &[name]].concat();
        match tree {
            UseTree::Path(path) => self.take_tree(&path.tree, &with(path.ident.to_string())),
            UseTree::Group(group) => group.items.iter().for_each(|tree| self.take_tree(tree, before)),
            UseTree::Name(name) if name.ident == "self" => self.take(before),
            UseTree::Name(name) => self.take(&with(name.ident.to_string())),
            UseTree::Rename(rename) => self.take(&with(rename.ident.to_string())),
            UseTree::Glob(_) => self.take(before),
        }
    }
}

impl<'a> Visit<'a> for Reader<'_> {
    fn visit_item_use(&mut self, item: &'a ItemUse) {
        self.take_tree(&item.tree, &[]);
    }

    fn visit_path(&mut self, path: &'a syn::Path) {
        // A single name may be that of a variable.
        if path.leading_colon.is_none() && path.segments.len() > 1 {
            self.take(&path.segments.iter().map(|segment| segment.ident.to_string()).collect::<Vec<_>>());
        }
        visit::visit_path(self, path);
    }

    fn visit_item_mod(&mut self, item: &'a ItemMod) {
        if item.content.is_some() && !is_for_tests(&item.attrs) {
            self.module.push(item.ident.to_string());
            visit::visit_item_mod(self, item);
            self.module.pop();
        }
    }

    // Paths in the arguments of attributes are no code.
    fn visit_attribute(&mut self, _: &'a Attribute) {}
}

/// Returns what each file uses outside its tests.
fn uses(files: BTreeMap<String, syn::File>) -> Uses {
    let files = without_tests(files);
    let used_by = |module: &str, file| {
        let names = module.split("::").filter(|name| !name.is_empty()).map(str::to_owned).collect();
        let mut reader = Reader { files: &files, module: names, used: BTreeSet::new() };
        reader.visit_file(file);
        reader.used.remove(module);
        reader.used
    };
    files.iter().map(|(module, file)| (module.clone(), used_by(module, file))).collect()
}

/// Returns what the modules at the top use, with all files below them.
fn at_the_top(uses: &Uses) -> Uses {
    let top = |module: &str| module.split("::").next().unwrap().to_owned();
    let mut result = Uses::new();
    for (module, used) in uses {
        let others = used.iter().map(|used| top(used)).filter(|used| *used != top(module));
        result.entry(top(module)).or_default().extend(others);
    }
    result
}

/// Returns the modules that use each other in circles, or lie between two of them.
fn circles(mut uses: Uses) -> Uses {
    loop {
        // One that uses none, or that none uses, is in no circle.
        let wanted: BTreeSet<_> = uses.values().flatten().cloned().collect();
        let rest = |(module, used): &(&String, &BTreeSet<String>)| !used.is_empty() && wanted.contains(*module);
        let kept: BTreeSet<_> = uses.iter().filter(rest).map(|(module, _)| module.clone()).collect();
        if kept.len() == uses.len() {
            return uses;
        }
        uses.retain(|module, _| kept.contains(module));
        uses.values_mut().for_each(|used| used.retain(|module| kept.contains(module)));
    }
}

#[test]
fn files_use_each_other_one_way() {
    for (folder, existing) in CRATES {
        let mut files = BTreeMap::new();
        read(&super::root().join(folder).join("src"), &[], &mut files);
        let uses = uses(files);
        for (from, to) in existing {
            assert!(uses[*from].contains(*to), "{folder}: {from} uses {to}: {:?}", uses[*from]);
        }
        for (what, uses) in [("modules at the top", at_the_top(&uses)), ("files", uses)] {
            let circles = circles(uses);
            assert!(circles.is_empty(), "{what} of {folder} use each other in a circle: {circles:#?}");
        }
    }
}

#[test]
fn circles_are_found_however_they_are_written() {
    let circles_of = |sources: &[(&str, &str)]| {
        let parsed = sources.iter().map(|(module, text)| ((*module).to_owned(), syn::parse_file(text).unwrap()));
        let uses = uses(parsed.collect());
        [circles(uses.clone()), circles(at_the_top(&uses))].map(|circles| circles.into_keys().collect::<Vec<_>>())
    };
    let back = |text| circles_of(&[("", "pub use a::A;"), ("a", "use crate::b::{self, B};"), ("b", text), ("c", "")]);
    for text in [
        "use super::a;",
        "pub(crate) use crate::{c::C, a::{A as Other}};",
        "fn f() -> crate::a::A { todo!() }",
        "fn f() { super::a::f() }",
        "mod inner { use super::super::a::*; }",
        "use crate::A;",
    ] {
        // An item of the root counts as all that the root uses.
        let expected: &[&str] = if text.contains("crate::A;") { &["", "a", "b"] } else { &["a", "b"] };
        assert_eq!(back(text), [expected, expected], "{text}");
    }
    for text in ["use crate::c::C;", "#[cfg(test)]\nmod tests { use crate::a::A; }", "/// [`crate::a::A`]\nstruct B;"] {
        assert_eq!(back(text), [[""; 0]; 2], "{text}");
    }
    // Files one way, the modules at the top in a circle.
    let folders = [("", ""), ("a", ""), ("a::x", "use crate::b::y::Y;"), ("b", ""), ("b::y", "use crate::a::z::Z;")];
    let folders = circles_of(&[&folders[..], &[("a::z", "")]].concat());
    assert_eq!(folders, [vec![], vec!["a".to_owned(), "b".to_owned()]]);
    // A module for tests only, in a file of its own.
    let tests =
        [("", "mod a;\n#[cfg(test)]\nmod testing;"), ("a", ""), ("testing", "use crate::a;"), ("testing::b", "")];
    assert_eq!(circles_of(&[&tests[..], &[("a::b", "use crate::testing;")]].concat()), [[""; 0]; 2]);
}
