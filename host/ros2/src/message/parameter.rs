//! Parameters of a node.

use serde::{Deserialize, Serialize};

/// `rcl_interfaces/msg/ParameterType`, of those that a board has.
pub mod parameter_type {
    /// There is no such parameter.
    pub const NOT_SET: u8 = 0;
    /// A whole number.
    pub const INTEGER: u8 = 2;
    /// A number.
    pub const DOUBLE: u8 = 3;
}

/// `rcl_interfaces/msg/ParameterValue`
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct ParameterValue {
    /// Which of the fields counts: one of [`parameter_type`].
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
    /// A number.
    #[must_use]
    pub fn double(double_value: f64) -> Self {
        Self { kind: parameter_type::DOUBLE, double_value, ..Self::default() }
    }

    /// The number; `None` of another type.
    #[must_use]
    pub fn number(&self) -> Option<f64> {
        match self.kind {
            parameter_type::DOUBLE => Some(self.double_value),
            parameter_type::INTEGER => Some(self.integer_value as f64),
            _ => None,
        }
    }
}

/// `rcl_interfaces/msg/Parameter`
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Parameter {
    /// Name.
    pub name: String,
    /// Value.
    pub value: ParameterValue,
}

/// `rcl_interfaces/msg/FloatingPointRange`
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct FloatingPointRange {
    /// Least.
    pub from_value: f64,
    /// Most.
    pub to_value: f64,
    /// 0: any between.
    pub step: f64,
}

/// `rcl_interfaces/msg/IntegerRange`
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct IntegerRange {
    /// Least.
    pub from_value: i64,
    /// Most.
    pub to_value: i64,
    /// 0: any between.
    pub step: u64,
}

/// `rcl_interfaces/msg/ParameterDescriptor`
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct ParameterDescriptor {
    /// Name.
    pub name: String,
    /// One of [`parameter_type`].
    pub kind: u8,
    /// Unit and meaning.
    pub description: String,
    /// How it can be changed.
    pub additional_constraints: String,
    /// Whether it cannot be set through the node.
    pub read_only: bool,
    /// Whether its type can change.
    pub dynamic_typing: bool,
    /// At most one.
    pub floating_point_range: Vec<FloatingPointRange>,
    /// At most one.
    pub integer_range: Vec<IntegerRange>,
}

/// `rcl_interfaces/msg/SetParametersResult`
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct SetParametersResult {
    /// Whether it was set.
    pub successful: bool,
    /// Why not.
    pub reason: String,
}

/// `rcl_interfaces/srv/ListParameters_Request`
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct ListParametersRequest {
    /// Names in front of a dot; none for all.
    pub prefixes: Vec<String>,
    /// So many parts of names behind the prefix; 0 for any number.
    pub depth: u64,
}

/// `rcl_interfaces/msg/ListParametersResult`
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct ListParametersResult {
    /// Names.
    pub names: Vec<String>,
    /// What stands in front of their last dots.
    pub prefixes: Vec<String>,
}

/// `rcl_interfaces/srv/ListParameters_Response`
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct ListParametersResponse {
    /// What there is.
    pub result: ListParametersResult,
}

/// Request of `GetParameters`, `GetParameterTypes` and `DescribeParameters` of `rcl_interfaces/srv`.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct NamesRequest {
    /// Names.
    pub names: Vec<String>,
}

/// `rcl_interfaces/srv/GetParameters_Response`
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct GetParametersResponse {
    /// One for each name.
    pub values: Vec<ParameterValue>,
}

/// `rcl_interfaces/srv/GetParameterTypes_Response`
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct GetParameterTypesResponse {
    /// One for each name, of [`parameter_type`].
    pub types: Vec<u8>,
}

/// `rcl_interfaces/srv/DescribeParameters_Response`
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct DescribeParametersResponse {
    /// One for each name.
    pub descriptors: Vec<ParameterDescriptor>,
}

/// Request of `SetParameters` and `SetParametersAtomically` of `rcl_interfaces/srv`.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct SetParametersRequest {
    /// What to set.
    pub parameters: Vec<Parameter>,
}

/// `rcl_interfaces/srv/SetParameters_Response`
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct SetParametersResponse {
    /// One for each parameter.
    pub results: Vec<SetParametersResult>,
}

/// `rcl_interfaces/srv/SetParametersAtomically_Response`
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct SetParametersAtomicallyResponse {
    /// Of all of them.
    pub result: SetParametersResult,
}
