//! `protocol/r4.lua`: the dissector beside this file, with the types as tables.

use std::fmt::Write;

use r4_protocol::{VERSION, frame::MAX_FRAME};

use super::{
    Input,
    model::{Field, Kind, Shape},
};

const TEMPLATE: &str = include_str!("dissector.lua");

/// The whole file.
pub(super) fn file(input: &Input) -> Result<String, String> {
    let algorithm = crc::CRC_16_IBM_SDLC;
    let mut types = format!(
        "local VERSION = {VERSION}\nlocal CRC_INITIAL, CRC_REFLECTED, CRC_FINAL = {:#06x}, {:#06x}, {:#06x}\n\nlocal TYPES = {{\n",
        algorithm.init,
        algorithm.poly.reverse_bits(),
        algorithm.xorout
    );
    for named in &input.model.0 {
        let text = match &named.kind {
            Kind::Struct(of) => format!("  {} = {{ fields = {} }},\n", named.name, fields(of)),
            Kind::Enum(variants) => {
                let variants = variants.iter().map(|variant| {
                    format!("    {{ name = \"{}\", fields = {} }},\n", variant.name, fields(&variant.fields))
                });
                format!("  {} = {{ variants = {{\n{}  }} }},\n", named.name, variants.collect::<String>())
            }
        };
        types.write_str(&text).map_err(|error| error.to_string())?;
    }
    types.push('}');
    Ok(TEMPLATE.replace("--@TYPES@", &types).replace("--@MAX_FRAME@", &MAX_FRAME.to_string()))
}

fn fields(fields: &[Field]) -> String {
    let field = |field: &Field| format!("{{ \"{}\", {} }}", field.name.unwrap_or("value"), shape(&field.shape));
    let all: Vec<String> = fields.iter().map(field).collect();
    if all.is_empty() { "{}".into() } else { format!("{{ {} }}", all.join(", ")) }
}

fn shape(of: &Shape) -> String {
    match of {
        Shape::Unsigned(_) => "\"unsigned\"".into(),
        Shape::Signed(_) => "\"signed\"".into(),
        Shape::Text { .. } => "\"string\"".into(),
        Shape::Option(of) => format!("{{ option = {} }}", shape(of)),
        Shape::List { of, .. } => format!("{{ list = {} }}", shape(of)),
        Shape::Array { of, length } => format!("{{ list = {}, length = {length} }}", shape(of)),
        Shape::Result { ok, refusal } => format!("{{ result = {{ {}, {} }} }}", shape(ok), shape(refusal)),
        Shape::Bool | Shape::U8 | Shape::I8 | Shape::F32 | Shape::Named(_) => format!("\"{}\"", of.text()),
    }
}
