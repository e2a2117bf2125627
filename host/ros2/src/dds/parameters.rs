//! Servers of the parameter services.

use futures::{
    FutureExt,
    channel::{mpsc::UnboundedSender, oneshot},
    future::join_all,
};
use ros2_client::{Message, Server};

use super::{
    NodeError,
    services::{Maker, answer},
};
use crate::{
    Order,
    message::{
        DescribeParametersResponse, GetParameterTypesResponse, GetParametersResponse, ListParametersRequest,
        ListParametersResponse, NamesRequest, SetParametersAtomicallyResponse, SetParametersRequest,
        SetParametersResponse,
    },
    parameters::ParameterCall,
};

impl Message for ListParametersRequest {}
impl Message for ListParametersResponse {}
impl Message for NamesRequest {}
impl Message for GetParametersResponse {}
impl Message for GetParameterTypesResponse {}
impl Message for DescribeParametersResponse {}
impl Message for SetParametersRequest {}
impl Message for SetParametersResponse {}
impl Message for SetParametersAtomicallyResponse {}

/// Servers of the parameter services of a node.
pub(super) struct ParameterServers {
    list: Server<ListParametersRequest, ListParametersResponse>,
    get: Server<NamesRequest, GetParametersResponse>,
    types: Server<NamesRequest, GetParameterTypesResponse>,
    describe: Server<NamesRequest, DescribeParametersResponse>,
    set: Server<SetParametersRequest, SetParametersResponse>,
    set_atomically: Server<SetParametersRequest, SetParametersAtomicallyResponse>,
}

impl ParameterServers {
    pub(super) fn new(make: &mut Maker<'_>) -> Result<Self, NodeError> {
        const PACKAGE: &str = "rcl_interfaces";
        Ok(Self {
            list: make.server("~/list_parameters", PACKAGE, "ListParameters")?,
            get: make.server("~/get_parameters", PACKAGE, "GetParameters")?,
            types: make.server("~/get_parameter_types", PACKAGE, "GetParameterTypes")?,
            describe: make.server("~/describe_parameters", PACKAGE, "DescribeParameters")?,
            set: make.server("~/set_parameters", PACKAGE, "SetParameters")?,
            set_atomically: make.server("~/set_parameters_atomically", PACKAGE, "SetParametersAtomically")?,
        })
    }

    /// Passes calls on as orders and answers them; never ends.
    pub(super) async fn run(&self, orders: &UnboundedSender<Order>) {
        join_all([
            call(&self.list, orders, ParameterCall::List).boxed_local(),
            call(&self.get, orders, ParameterCall::Get).boxed_local(),
            call(&self.types, orders, ParameterCall::Types).boxed_local(),
            call(&self.describe, orders, ParameterCall::Describe).boxed_local(),
            call(&self.set, orders, ParameterCall::Set).boxed_local(),
            call(&self.set_atomically, orders, ParameterCall::SetAtomically).boxed_local(),
        ])
        .await;
    }
}

/// Passes the calls of one service on and answers them. After the end of the session the answer is empty: there are no parameters.
async fn call<Q: Message + Clone + 'static, A: Message + Default + 'static>(
    server: &Server<Q, A>,
    orders: &UnboundedSender<Order>,
    made: fn(Q, oneshot::Sender<A>) -> ParameterCall,
) {
    answer(server, orders, move |request, to| Order::Parameters(made(request, to)), A::default).await;
}
