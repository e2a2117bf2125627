//! Values of constants, computed from their source text.
//!
//! Only the expressions that a protocol's constants have are supported: numbers, other constants, arithmetic, lists,
//! ranges, durations. A test compares the most important ones with the compiler's values.

use std::fmt;

use serde_json::{Value as Json, json};
use syn::{BinOp, Expr, ExprLit, Lit, RangeLimits, UnOp};

use super::source::Source;

#[derive(Clone, Debug, PartialEq)]
pub(super) enum Value {
    Integer(i128),
    /// Value of an `f32`, as the double that is equal to it.
    Float(f64),
    List(Vec<Value>),
    /// Range from the first to the last value, both included.
    Range(Box<Value>, Box<Value>),
    /// Duration in whole milliseconds.
    Milliseconds(i128),
}

impl Value {
    /// Computes the constant `name`.
    ///
    /// # Errors
    /// There is none, or it has an expression that is not supported.
    pub(super) fn of(name: &str, source: &Source) -> Result<Self, String> {
        let constant = source.constant_source(name)?;
        let of = name.split_once("::").map(|(of, _)| of);
        compute(&constant.value, source, of).ok_or_else(|| format!("{name} is not made of numbers"))
    }

    pub(super) fn json(&self) -> Json {
        match self {
            Self::Integer(number) | Self::Milliseconds(number) => {
                i64::try_from(*number).map_or_else(|_| json!(u64::try_from(*number).unwrap_or(u64::MAX)), Json::from)
            }
            Self::Float(number) => json!(number),
            Self::List(all) => all.iter().map(Self::json).collect(),
            Self::Range(first, last) => json!({ "first": first.json(), "last": last.json() }),
        }
    }

    /// Returns the value as a length or a limit.
    pub(super) fn count(&self) -> Option<usize> {
        if let Self::Integer(number) = self { usize::try_from(*number).ok() } else { None }
    }
}

impl fmt::Display for Value {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Integer(number) => write!(f, "{number}"),
            Self::Float(number) => write!(f, "{}", *number as f32),
            Self::List(all) => f.write_str(&all.iter().map(Self::to_string).collect::<Vec<_>>().join(", ")),
            Self::Range(first, last) => write!(f, "{first} to {last}"),
            Self::Milliseconds(number) => write!(f, "{number} ms"),
        }
    }
}

/// Computes an expression. `of` is the type whose constant it is, which `Self` names.
fn compute(expression: &Expr, source: &Source, of: Option<&str>) -> Option<Value> {
    let compute = |expression| compute(expression, source, of);
    match expression {
        Expr::Lit(ExprLit { lit: Lit::Int(number), .. }) => number.base10_parse().ok().map(Value::Integer),
        Expr::Lit(ExprLit { lit: Lit::Float(number), .. }) => {
            // As an f32, because the protocol has no constant of type f64.
            number.base10_parse::<f32>().ok().map(|number| Value::Float(number.into()))
        }
        Expr::Paren(inner) => compute(&inner.expr),
        // Constants are cast without loss only, so the value stays.
        Expr::Cast(inner) => compute(&inner.expr),
        Expr::Array(list) => list.elems.iter().map(compute).collect::<Option<_>>().map(Value::List),
        Expr::Range(range) => {
            let (first, last) = (compute(range.start.as_deref()?)?, compute(range.end.as_deref()?)?);
            match (&range.limits, &last) {
                (RangeLimits::Closed(_), _) => Some(Value::Range(first.into(), last.into())),
                // The last value of a half-open range is one less; floats have no such value.
                (RangeLimits::HalfOpen(_), Value::Integer(end)) => {
                    Some(Value::Range(first.into(), Value::Integer(end - 1).into()))
                }
                _ => None,
            }
        }
        Expr::Unary(unary) => match (&unary.op, compute(&unary.expr)?) {
            (UnOp::Neg(_), Value::Integer(number)) => Some(Value::Integer(-number)),
            (UnOp::Neg(_), Value::Float(number)) => Some(Value::Float(-number)),
            _ => None,
        },
        Expr::Binary(binary) => arithmetic(&binary.op, &compute(&binary.left)?, &compute(&binary.right)?),
        Expr::Call(call) => {
            let Expr::Path(function) = &*call.func else { return None };
            let name = function.path.segments.last()?.ident.to_string();
            match (name.as_str(), compute(call.args.first()?)?) {
                ("from_millis", Value::Integer(number)) => Some(Value::Milliseconds(number)),
                ("from_secs", Value::Integer(number)) => Some(Value::Milliseconds(1000 * number)),
                _ => None,
            }
        }
        Expr::Path(path) => {
            let parts: Vec<String> = path.path.segments.iter().map(|segment| segment.ident.to_string()).collect();
            let parts: Vec<&str> = parts.iter().map(String::as_str).collect();
            match parts[..] {
                ["i16", "MIN"] => Some(Value::Integer(i16::MIN.into())),
                ["u16", "MAX"] => Some(Value::Integer(u16::MAX.into())),
                ["u8", "MAX"] => Some(Value::Integer(u8::MAX.into())),
                // Names of other modules are unique in the source, so their paths can be ignored.
                ["Self", name] => Value::of(&format!("{}::{name}", of?), source).ok(),
                [.., name] => Value::of(name, source).ok(),
                [] => None,
            }
        }
        _ => None,
    }
}

fn arithmetic(operator: &BinOp, left: &Value, right: &Value) -> Option<Value> {
    match (left, right) {
        (Value::Integer(left), Value::Integer(right)) => match operator {
            BinOp::Add(_) => left.checked_add(*right),
            BinOp::Sub(_) => left.checked_sub(*right),
            BinOp::Mul(_) => left.checked_mul(*right),
            BinOp::Div(_) => left.checked_div(*right),
            BinOp::Shl(_) => u32::try_from(*right).ok().and_then(|right| left.checked_shl(right)),
            BinOp::BitOr(_) => Some(left | right),
            _ => None,
        }
        .map(Value::Integer),
        // Rounded to f32, as the compiler does.
        (Value::Float(left), Value::Float(right)) => match operator {
            BinOp::Mul(_) => Some(*left as f32 * *right as f32),
            BinOp::Div(_) => Some(*left as f32 / *right as f32),
            _ => None,
        }
        .map(|number| Value::Float(number.into())),
        _ => None,
    }
}

#[cfg(test)]
mod tests {
    use r4_protocol::{can, config, cycle, frame, log, message};

    use super::*;

    #[test]
    fn constants_have_the_values_that_the_compiler_gives_them() {
        let source = Source::read(&crate::root().join("protocol/src")).expect("it is read");
        let whole = |number: usize| Value::Integer(number as i128);
        let list = |rates: [u16; 4]| Value::List(rates.map(|rate| Value::Integer(rate.into())).to_vec());
        let timeouts = config::LINK_TIMEOUT_MS;
        for (name, value) in [
            ("VERSION", Value::Integer(r4_protocol::VERSION.into())),
            ("MAX_MESSAGE", whole(frame::MAX_MESSAGE)),
            ("MAX_FRAME", whole(frame::MAX_FRAME)),
            ("MAX_LOG", whole(log::MAX_LOG)),
            ("IMAGE_BYTES", whole(log::IMAGE_BYTES)),
            ("MAX_POINTS", whole(message::MAX_POINTS)),
            ("PATH_POINTS", whole(message::PATH_POINTS)),
            ("CONTROL_SHARE", Value::Float(message::CONTROL_SHARE.into())),
            ("SETPOINTS", whole(can::SETPOINTS)),
            ("BITRATES_KBIT", list(can::BITRATES_KBIT)),
            ("Node::COUNT", Value::Integer(can::Node::COUNT.into())),
            ("CYCLE_FRAME", whole(cycle::CYCLE_FRAME)),
            ("CYCLE_STATE_FRAME", whole(cycle::CYCLE_STATE_FRAME)),
            ("DUTY_SCALE", Value::Float(cycle::DUTY_SCALE.into())),
            ("NOTHING", Value::Integer(cycle::NOTHING.into())),
            ("MAX_EXACT", Value::Integer(config::MAX_EXACT.into())),
            ("PidGains::MAX", Value::Float(config::PidGains::MAX.into())),
            (
                "LINK_TIMEOUT_MS",
                Value::Range(
                    Value::Integer((*timeouts.start()).into()).into(),
                    Value::Integer((*timeouts.end()).into()).into(),
                ),
            ),
        ] {
            assert_eq!(Value::of(name, &source), Ok(value), "{name}");
        }
        // A block expression is not supported, and must be an error and not a wrong value.
        assert!(Value::of("SCHEMA_HASH", &source).is_err_and(|problem| problem.contains("not made of numbers")));
        assert!(Value::of("NO_SUCH", &source).is_err_and(|problem| problem.contains("no constant NO_SUCH")));
    }
}
