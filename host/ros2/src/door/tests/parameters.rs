//! Tests of parameters in virtual time.

use super::*;
use crate::{
    message::{ListParametersRequest, NamesRequest, Parameter, ParameterValue, SetParametersRequest},
    parameters::ParameterCall,
};

impl Ros<'_> {
    async fn ask<Q, A>(&self, call: impl FnOnce(Q, oneshot::Sender<A>) -> ParameterCall, request: Q) -> A {
        let (answer, answered) = oneshot::channel();
        self.send(Order::Parameters(call(request, answer)));
        answered.await.expect("an answer")
    }

    async fn parameter(&self, name: &str) -> f64 {
        let request = NamesRequest { names: vec![name.into()] };
        let values = self.ask(ParameterCall::Get, request).await.values;
        values[0].number().unwrap_or_else(|| panic!("{name} is not set"))
    }
}

fn wanted(values: &[(&str, f64)]) -> SetParametersRequest {
    let parameter =
        |(name, value): &(&str, f64)| Parameter { name: (*name).into(), value: ParameterValue::double(*value) };
    SetParametersRequest { parameters: values.iter().map(parameter).collect() }
}

#[test]
fn parameters_are_the_keys_of_the_configuration() {
    beside("sim:osmc-bench", async |ros| {
        let known = ros.session.board.parameters().await.expect("parameters");
        let mut names = Vec::new();
        // All at once are too many for an answer.
        let all = ros.ask(ParameterCall::List, ListParametersRequest::default()).await.result;
        assert_eq!(all.names, [""; 0]);
        for prefix in all.prefixes {
            let part = ros.ask(ParameterCall::List, ListParametersRequest { prefixes: vec![prefix], depth: 0 }).await;
            names.extend(part.result.names);
        }
        let mut keys: Vec<_> = known.iter().map(|info| info.key.to_string()).collect();
        names.sort();
        keys.sort();
        assert_eq!(names, keys);
        // Values of osmc-bench.toml.
        assert_eq!(ros.parameter("osmc0.position_kp").await, 4.0);
        assert_eq!(ros.parameter("board.link_timeout_ms").await, 200.0);
    });
}

#[test]
fn numbers_that_hold_from_the_next_start_on_are_refused() {
    beside("sim:osmc-bench", async |ros| {
        let many = wanted(&[("osmc0.position_kp", 3.0), ("osmc0.speed_max", 1.0), ("a", 1.0)]);
        let results = ros.ask(ParameterCall::Set, many).await.results;
        assert_eq!(results.iter().map(|result| result.successful).collect::<Vec<_>>(), [true, false, false]);
        assert!(results[1].reason.contains("r4 config set osmc0.speed_max 1 --save"), "{results:?}");
        assert!(results[2].reason.contains("no parameter a"), "{results:?}");
        assert_eq!(ros.parameter("osmc0.position_kp").await, 3.0);
        assert_eq!(ros.parameter("osmc0.speed_max").await, 5.0);
    });
}

/// A wheel with zero gains and no feed-forward does not turn; with the values of openscout.toml it does.
#[test]
fn gains_are_set_at_once() {
    let names =
        ["dhb0.speed_kp", "dhb0.speed_ki", "dhb0.speed_kd", "dhb0.static_duty", "dhb0.duty_per_speed", "dhb0.cascade"];
    let set = |values: [f64; 6]| wanted(&std::array::from_fn::<_, 6, _>(|at| (names[at], values[at])));
    beside("sim:openscout", async |ros| {
        ros.armed().await;
        let mut before = [0.0; 6];
        for (value, name) in before.iter_mut().zip(names) {
            *value = ros.parameter(name).await;
        }
        let joints = JointState { name: vec!["dhb0".into()], velocity: vec![3.0], ..JointState::default() };
        let turn = async || {
            for _ in 0..50 {
                ros.send(Order::Joints { stamp: Some(Stamp::default()), joints: joints.clone() });
                ros.sleep_s(0.02).await;
            }
            ros.joint("dhb0").1
        };
        let result = ros.ask(ParameterCall::SetAtomically, set([0.0; 6])).await.result;
        assert!(result.successful, "{}", result.reason);
        let still_rad_s = turn().await;
        assert!(still_rad_s.abs() < 0.2, "{still_rad_s}");
        let result = ros.ask(ParameterCall::SetAtomically, set(before)).await.result;
        assert!(result.successful, "{}", result.reason);
        let turning_rad_s = turn().await;
        assert!(turning_rad_s > 2.0, "{turning_rad_s}");
    });
}

#[test]
fn parameters_are_set_together_or_not_at_all() {
    beside("sim:osmc-bench", async |ros| {
        // The board refuses the negative gain of the speed loop after it has accepted that of the position loop, which is then restored.
        let half = wanted(&[("osmc0.position_kp", 1.0), ("osmc0.speed_kp", -1.0)]);
        let result = ros.ask(ParameterCall::SetAtomically, half).await.result;
        assert!(!result.successful && !result.reason.is_empty(), "{result:?}");
        assert_eq!((ros.parameter("osmc0.position_kp").await, ros.parameter("osmc0.speed_kp").await), (4.0, 0.144));
        // Type 4 is a text.
        let text = Parameter {
            name: "osmc0.position_kp".into(),
            value: ParameterValue { kind: 4, ..ParameterValue::default() },
        };
        let request = SetParametersRequest { parameters: vec![text] };
        let result = ros.ask(ParameterCall::SetAtomically, request).await.result;
        assert!(result.reason.contains("is a number"), "{result:?}");
        let endless = wanted(&[("osmc0.position_kp", f64::INFINITY)]);
        assert!(ros.ask(ParameterCall::SetAtomically, endless).await.result.reason.contains("finite"));
    });
}
