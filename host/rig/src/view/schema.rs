//! JSON Schemas of the messages, written from their fields.

/// Schema of an object with these fields; each is a name and the schema of its value.
fn object(fields: &[(&str, &str)]) -> String {
    let fields: Vec<String> = fields.iter().map(|(name, schema)| format!(r#""{name}":{schema}"#)).collect();
    format!(r#"{{"type":"object","properties":{{{}}}}}"#, fields.join(","))
}

fn list(item: &str) -> String {
    format!(r#"{{"type":"array","items":{item}}}"#)
}

/// Schema with the title by which viewers know it.
fn titled(title: &str, fields: &[(&str, &str)]) -> String {
    object(fields).replacen('{', &format!(r#"{{"title":"{title}","#), 1)
}

const NUMBER: &str = r#"{"type":"number"}"#;
const INTEGER: &str = r#"{"type":"integer"}"#;
const TEXT: &str = r#"{"type":"string"}"#;
const TRUTH: &str = r#"{"type":"boolean"}"#;

fn time() -> String {
    object(&[("sec", INTEGER), ("nsec", INTEGER)])
}

fn vector() -> String {
    object(&[("x", NUMBER), ("y", NUMBER), ("z", NUMBER)])
}

fn quaternion() -> String {
    object(&[("x", NUMBER), ("y", NUMBER), ("z", NUMBER), ("w", NUMBER)])
}

fn pose() -> String {
    object(&[("position", &vector()), ("orientation", &quaternion())])
}

fn color() -> String {
    object(&[("r", NUMBER), ("g", NUMBER), ("b", NUMBER), ("a", NUMBER)])
}

/// Schema of [`FrameTransforms`](super::message::FrameTransforms).
pub(super) fn frame_transforms() -> String {
    let transform = object(&[
        ("timestamp", &time()),
        ("parent_frame_id", TEXT),
        ("child_frame_id", TEXT),
        ("translation", &vector()),
        ("rotation", &quaternion()),
    ]);
    titled("foxglove.FrameTransforms", &[("transforms", &list(&transform))])
}

/// Schema of [`PosesInFrame`](super::message::PosesInFrame).
pub(super) fn poses_in_frame() -> String {
    let fields = [("timestamp", time()), ("frame_id", TEXT.to_owned()), ("poses", list(&pose()))];
    titled("foxglove.PosesInFrame", &fields.each_ref().map(|(name, schema)| (*name, schema.as_str())))
}

/// Schema of [`SceneUpdate`](super::message::SceneUpdate).
pub(super) fn scene_update() -> String {
    let nothing = list(&object(&[]));
    let line = object(&[
        ("type", INTEGER),
        ("pose", &pose()),
        ("thickness", NUMBER),
        ("scale_invariant", TRUTH),
        ("points", &list(&vector())),
        ("color", &color()),
        ("colors", &list(&color())),
        ("indices", &list(INTEGER)),
    ]);
    let cube = object(&[("pose", &pose()), ("size", &vector()), ("color", &color())]);
    let cylinder = object(&[
        ("pose", &pose()),
        ("size", &vector()),
        ("bottom_scale", NUMBER),
        ("top_scale", NUMBER),
        ("color", &color()),
    ]);
    let entity = object(&[
        ("timestamp", &time()),
        ("frame_id", TEXT),
        ("id", TEXT),
        ("lifetime", &time()),
        ("frame_locked", TRUTH),
        ("metadata", &nothing),
        ("arrows", &nothing),
        ("cubes", &list(&cube)),
        ("spheres", &nothing),
        ("cylinders", &list(&cylinder)),
        ("lines", &list(&line)),
        ("triangles", &nothing),
        ("texts", &nothing),
        ("models", &nothing),
    ]);
    titled("foxglove.SceneUpdate", &[("deletions", &nothing), ("entities", &list(&entity))])
}
