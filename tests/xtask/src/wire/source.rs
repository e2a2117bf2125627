//! Source text of the protocol, for what its types do not have: doc comments, capacities of lists, constants.

use std::{collections::BTreeMap, fs, path::Path};

use syn::{Attribute, Expr, ExprLit, Fields, ImplItem, Item, Lit, Meta, Type};

/// Relevant content of a Rust file, or of a folder of such files.
#[derive(Default)]
pub(super) struct Source {
    /// Types by name. Those of one name in several modules cannot be told apart, so none of them may be asked for.
    types: BTreeMap<String, Vec<TypeSource>>,
    /// Constants by name, those of a type as `Type::NAME`.
    constants: BTreeMap<String, Vec<ConstantSource>>,
    /// Comments of modules, by the names of the modules.
    modules: BTreeMap<String, String>,
}

/// Struct or enum with its comments.
pub(super) struct TypeSource {
    pub(super) doc: String,
    /// Fields of a struct; those of a tuple have no names.
    pub(super) fields: Vec<FieldSource>,
    /// Variants of an enum.
    pub(super) variants: Vec<VariantSource>,
}

pub(super) struct VariantSource {
    pub(super) name: String,
    pub(super) doc: String,
    pub(super) fields: Vec<FieldSource>,
}

pub(super) struct FieldSource {
    pub(super) doc: String,
    pub(super) written: Type,
}

pub(super) struct ConstantSource {
    pub(super) module: String,
    pub(super) doc: String,
    pub(super) is_public: bool,
    pub(super) value: Expr,
}

impl Source {
    /// Reads the file, or every Rust file below the folder.
    ///
    /// # Errors
    /// The name of the file that cannot be read or is not Rust.
    pub(super) fn read(path: &Path) -> Result<Self, String> {
        let mut source = Self::default();
        source.add(path)?;
        Ok(source)
    }

    fn add(&mut self, path: &Path) -> Result<(), String> {
        let wrong = |problem: &dyn std::fmt::Display| format!("{}: {problem}", path.display());
        if path.is_dir() {
            let entries = fs::read_dir(path).and_then(Iterator::collect::<Result<Vec<_>, _>>);
            let mut paths: Vec<_> = entries.map_err(|error| wrong(&error))?.iter().map(|entry| entry.path()).collect();
            paths.sort();
            return paths.iter().try_for_each(|path| self.add(path));
        }
        if path.extension().is_none_or(|extension| extension != "rs") {
            return Ok(());
        }
        let text = fs::read_to_string(path).map_err(|error| wrong(&error))?;
        let file = syn::parse_file(&text).map_err(|error| wrong(&error))?;
        let stem = path.file_stem().map(|stem| stem.to_string_lossy().into_owned()).unwrap_or_default();
        let folder = path.parent().and_then(Path::file_name).map(|name| name.to_string_lossy().into_owned());
        let module = if stem == "mod" { folder.unwrap_or_default() } else { stem };
        self.modules.insert(module.clone(), doc(&file.attrs));
        file.items.into_iter().for_each(|item| self.take(&module, item));
        Ok(())
    }

    fn take(&mut self, module: &str, item: Item) {
        match item {
            Item::Struct(item) => {
                let source = TypeSource { doc: doc(&item.attrs), fields: fields(item.fields), variants: Vec::new() };
                self.types.entry(item.ident.to_string()).or_default().push(source);
            }
            Item::Enum(item) => {
                let variants = item.variants.into_iter().map(|variant| VariantSource {
                    name: variant.ident.to_string(),
                    doc: doc(&variant.attrs),
                    fields: fields(variant.fields),
                });
                let source = TypeSource { doc: doc(&item.attrs), fields: Vec::new(), variants: variants.collect() };
                self.types.entry(item.ident.to_string()).or_default().push(source);
            }
            Item::Const(item) => {
                let is_public = matches!(item.vis, syn::Visibility::Public(_));
                self.constant(item.ident.to_string(), module, &item.attrs, is_public, *item.expr);
            }
            Item::Impl(item) if item.trait_.is_none() => {
                let Type::Path(of) = *item.self_ty else { return };
                let Some(of) = of.path.segments.last().map(|segment| segment.ident.to_string()) else { return };
                for inner in item.items {
                    if let ImplItem::Const(inner) = inner {
                        let is_public = matches!(inner.vis, syn::Visibility::Public(_));
                        let name = format!("{of}::{}", inner.ident);
                        self.constant(name, module, &inner.attrs, is_public, inner.expr);
                    }
                }
            }
            _ => {}
        }
    }

    fn constant(&mut self, name: String, module: &str, attributes: &[Attribute], is_public: bool, value: Expr) {
        let source = ConstantSource { module: module.into(), doc: doc(attributes), is_public, value };
        self.constants.entry(name).or_default().push(source);
    }

    /// Returns the type of this name.
    ///
    /// # Errors
    /// There is none, or several.
    pub(super) fn of_type(&self, name: &str) -> Result<&TypeSource, String> {
        only(self.types.get(name), "type", name)
    }

    /// Returns the constant of this name.
    ///
    /// # Errors
    /// There is none, or several.
    pub(super) fn constant_source(&self, name: &str) -> Result<&ConstantSource, String> {
        only(self.constants.get(name), "constant", name)
    }

    /// Iterates over the constants whose name is unique.
    pub(super) fn constants(&self) -> impl Iterator<Item = (&str, &ConstantSource)> {
        self.constants.iter().filter_map(|(name, sources)| match &sources[..] {
            [source] => Some((name.as_str(), source)),
            _ => None,
        })
    }

    /// Returns the comment of the item that `path` names: a module, a constant, a type, or a variant as
    /// `Type::Variant`.
    ///
    /// # Errors
    /// There is no such item, or it has no comment.
    pub(super) fn doc(&self, path: &str) -> Result<&str, String> {
        let variant = path.split_once("::").and_then(|(of, name)| {
            self.of_type(of).ok()?.variants.iter().find(|variant| variant.name == name).map(|variant| &variant.doc)
        });
        let found = variant
            .or_else(|| self.of_type(path).ok().map(|of| &of.doc))
            .or_else(|| self.constant_source(path).ok().map(|constant| &constant.doc))
            .or_else(|| self.modules.get(path));
        found.filter(|doc| !doc.is_empty()).map(String::as_str).ok_or_else(|| format!("{path} has no comment"))
    }
}

fn only<'a, T>(found: Option<&'a Vec<T>>, what: &str, name: &str) -> Result<&'a T, String> {
    match found.map_or(&[][..], Vec::as_slice) {
        [one] => Ok(one),
        [] => Err(format!("the source has no {what} {name}")),
        several => Err(format!("the source has {} {what}s {name}: give one of them another name", several.len())),
    }
}

fn fields(fields: Fields) -> Vec<FieldSource> {
    fields.into_iter().map(|field| FieldSource { doc: doc(&field.attrs), written: field.ty }).collect()
}

/// Returns the text of the doc comments, without the syntax that only rustdoc understands.
fn doc(attributes: &[Attribute]) -> String {
    let lines = attributes.iter().filter_map(|attribute| {
        let Meta::NameValue(pair) = &attribute.meta else { return None };
        let Expr::Lit(ExprLit { lit: Lit::Str(text), .. }) = &pair.value else { return None };
        pair.path.is_ident("doc").then(|| text.value())
    });
    let lines: Vec<String> = lines.map(|line| line.strip_prefix(' ').unwrap_or(&line).to_owned()).collect();
    let is_target = |line: &&String| line.starts_with('[') && line.contains("]: ");
    let text: Vec<String> = lines.iter().filter(|line| !is_target(line)).map(|line| unlinked(line)).collect();
    text.join("\n").trim().to_owned()
}

/// Replaces links to items by the item: both forms of a link to `crate::a::B`, with and without a text of its own,
/// become `B`.
fn unlinked(line: &str) -> String {
    let mut text = String::new();
    let mut rest = line;
    while let Some((before, link)) = rest.split_once('[') {
        text.push_str(before);
        let Some((name, after)) = link.split_once(']').filter(|(name, _)| name.starts_with('`') && name.ends_with('`'))
        else {
            text.push('[');
            rest = link;
            continue;
        };
        text.push_str(&shown(name));
        rest = after.strip_prefix('(').and_then(|target| target.split_once(')')).map_or(after, |(_, after)| after);
    }
    text + rest
}

/// Returns the path of an item without modules: a type, and its member.
fn shown(name: &str) -> String {
    let parts: Vec<&str> = name.trim_matches('`').split("::").collect();
    let begin = parts.iter().position(|part| part.starts_with(char::is_uppercase)).unwrap_or(parts.len() - 1);
    format!("`{}`", parts[begin..].join("::"))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn links_become_what_they_name() {
        assert_eq!(
            unlinked("From [`DeviceInfo`]; see [`crate::cycle::Cycle`](x) [1]."),
            "From `DeviceInfo`; see `Cycle` [1]."
        );
        assert_eq!(unlinked("in [`crate::config::A::b`] of [`crate::config`]"), "in `A::b` of `config`");
        assert_eq!(unlinked("`CRC-16 [half"), "`CRC-16 [half");
    }

    #[test]
    fn comments_are_found_by_what_they_are_of() {
        let text = "//! A module.\n/// A.\n///\n/// [`B`]: b\npub struct A { /** no */ #[doc = \" B.\"] b: u8 }\n\
                    /// E.\nenum E { /// V.\n V { /// F.\n f: Vec<u8, 3> } }\nimpl A { /// C.\n pub const C: u8 = 1; }";
        let file = syn::parse_file(text).expect("it is Rust");
        let mut source = Source::default();
        source.modules.insert("m".into(), doc(&file.attrs));
        file.items.into_iter().for_each(|item| source.take("m", item));
        for (path, expected) in [("m", "A module."), ("A", "A."), ("E", "E."), ("E::V", "V."), ("A::C", "C.")] {
            assert_eq!(source.doc(path), Ok(expected), "{path}");
        }
        assert_eq!(source.of_type("E").expect("one").variants[0].fields[0].doc, "F.");
        assert!(source.doc("E::W").is_err() && source.constant_source("C").is_err());
    }
}
