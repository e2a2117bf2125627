//! Target of scenarios, as `r4 scenario` reads them.

use r4_rig::scenario::{Action, Scenario};

/// Target: reads any text. Times of an accepted scenario can be waited for, and its quantities given to a world.
///
/// # Panics
/// An accepted scenario breaks one of these rules.
pub fn scenario(bytes: &[u8]) -> bool {
    let Ok(text) = std::str::from_utf8(bytes) else { return false };
    let Ok(scenario) = toml::from_str::<Scenario>(text) else { return false };
    for step in &scenario.steps {
        let mut seconds = vec![step.at_s];
        match step.action {
            Action::BusStuck { for_s, .. } => seconds.push(for_s),
            Action::Distance { distance_m, .. } => assert!(distance_m.is_none_or(f64::is_finite), "{step:?}"),
            Action::Supply { emf_v, .. } => assert!(emf_v.is_finite(), "{step:?}"),
            _ => {}
        }
        let ns = seconds.iter().try_fold(0u64, |sum, seconds| sum.checked_add((seconds * 1e9) as u64));
        assert!(ns.is_some_and(|ns| ns < u64::MAX / 2) && seconds.iter().all(|at| *at >= 0.0), "{step:?}");
    }
    true
}
