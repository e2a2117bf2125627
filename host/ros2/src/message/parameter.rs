//! Messages and services for the parameters of a node.

use serde::{Deserialize, Serialize};

/// Type numbers of `rcl_interfaces/msg/ParameterType`, as far as a board's parameters need them.
pub mod parameter_type {
    /// Type of a parameter that does not exist.
    pub const NOT_SET: u8 = 0;
    /// Type of a 64-bit integer.
    pub const INTEGER: u8 = 2;
    /// Type of a number in double precision.
    pub const DOUBLE: u8 = 3;
}

/// Message `rcl_interfaces/msg/ParameterValue`: value of one of several types.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct ParameterValue {
    /// Type of the value, which selects the field to read: one of [`parameter_type`].
    pub kind: u8,
    /// Value of type 1.
    pub bool_value: bool,
    /// Value of type 2.
    pub integer_value: i64,
    /// Value of type 3.
    pub double_value: f64,
    /// Value of type 4.
    pub string_value: String,
    /// Value of type 5.
    pub byte_array_value: Vec<u8>,
    /// Value of type 6.
    pub bool_array_value: Vec<bool>,
    /// Value of type 7.
    pub integer_array_value: Vec<i64>,
    /// Value of type 8.
    pub double_array_value: Vec<f64>,
    /// Value of type 9.
    pub string_array_value: Vec<String>,
}

impl ParameterValue {
    /// Creates a value in double precision.
    #[must_use]
    pub fn double(double_value: f64) -> Self {
        Self { kind: parameter_type::DOUBLE, double_value, ..Self::default() }
    }

    /// Returns the number of a double or an integer; `None` for other types.
    #[must_use]
    pub fn number(&self) -> Option<f64> {
        match self.kind {
            parameter_type::DOUBLE => Some(self.double_value),
            parameter_type::INTEGER => Some(self.integer_value as f64),
            _ => None,
        }
    }
}

/// Message `rcl_interfaces/msg/Parameter`: parameter with its value.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Parameter {
    /// Name of the parameter.
    pub name: String,
    /// Value of the parameter.
    pub value: ParameterValue,
}

/// Message `rcl_interfaces/msg/FloatingPointRange`: range of a number.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct FloatingPointRange {
    /// Lower limit, which is allowed.
    pub from_value: f64,
    /// Upper limit, which is allowed.
    pub to_value: f64,
    /// Step between allowed values; 0 allows any value in the range.
    pub step: f64,
}

/// Message `rcl_interfaces/msg/IntegerRange`: range of an integer.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct IntegerRange {
    /// Lower limit, which is allowed.
    pub from_value: i64,
    /// Upper limit, which is allowed.
    pub to_value: i64,
    /// Step between allowed values; 0 allows any value in the range.
    pub step: u64,
}

/// Message `rcl_interfaces/msg/ParameterDescriptor`: description of a parameter.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct ParameterDescriptor {
    /// Name of the parameter.
    pub name: String,
    /// Type, one of [`parameter_type`].
    pub kind: u8,
    /// Unit and built-in value, as text.
    pub description: String,
    /// Command that changes the parameter for good, as text.
    pub additional_constraints: String,
    /// True for a parameter that cannot be set through the node.
    pub read_only: bool,
    /// True for a parameter whose type can change.
    pub dynamic_typing: bool,
    /// Range of a number in double precision; empty or one element.
    pub floating_point_range: Vec<FloatingPointRange>,
    /// Range of an integer; empty or one element.
    pub integer_range: Vec<IntegerRange>,
}

/// Message `rcl_interfaces/msg/SetParametersResult`: result of setting parameters.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct SetParametersResult {
    /// True when the parameter was set.
    pub successful: bool,
    /// Reason for a refusal; empty after success.
    pub reason: String,
}

/// Request `rcl_interfaces/srv/ListParameters_Request` of `~/list_parameters`.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct ListParametersRequest {
    /// Prefixes of the names to list, without the dot behind them; an empty list asks for all names.
    pub prefixes: Vec<String>,
    /// Maximum number of parts of a name behind its prefix; 0 for no limit.
    pub depth: u64,
}

/// Message `rcl_interfaces/msg/ListParametersResult`: names of parameters.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct ListParametersResult {
    /// Names of the listed parameters.
    pub names: Vec<String>,
    /// Prefixes of these names, up to the last dot, each once.
    pub prefixes: Vec<String>,
}

/// Response `rcl_interfaces/srv/ListParameters_Response` of `~/list_parameters`.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct ListParametersResponse {
    /// Names that match the request.
    pub result: ListParametersResult,
}

/// Request of `GetParameters`, `GetParameterTypes` and `DescribeParameters` of `rcl_interfaces/srv`.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct NamesRequest {
    /// Names of the queried parameters.
    pub names: Vec<String>,
}

/// Response `rcl_interfaces/srv/GetParameters_Response` of `~/get_parameters`.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct GetParametersResponse {
    /// Values in the order of the requested names.
    pub values: Vec<ParameterValue>,
}

/// Response `rcl_interfaces/srv/GetParameterTypes_Response` of `~/get_parameter_types`.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct GetParameterTypesResponse {
    /// Types in the order of the requested names, of [`parameter_type`].
    pub types: Vec<u8>,
}

/// Response `rcl_interfaces/srv/DescribeParameters_Response` of `~/describe_parameters`.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct DescribeParametersResponse {
    /// Descriptions in the order of the requested names.
    pub descriptors: Vec<ParameterDescriptor>,
}

/// Request of `SetParameters` and `SetParametersAtomically` of `rcl_interfaces/srv`.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct SetParametersRequest {
    /// Parameters to set, with their new values.
    pub parameters: Vec<Parameter>,
}

/// Response `rcl_interfaces/srv/SetParameters_Response` of `~/set_parameters`.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct SetParametersResponse {
    /// Results in the order of the requested parameters.
    pub results: Vec<SetParametersResult>,
}

/// Response `rcl_interfaces/srv/SetParametersAtomically_Response` of `~/set_parameters_atomically`.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct SetParametersAtomicallyResponse {
    /// Common result of all parameters: all are set, or none.
    pub result: SetParametersResult,
}
