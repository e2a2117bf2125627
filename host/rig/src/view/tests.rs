//! The view in recordings of simulated drives.

use std::{cell::RefCell, collections::BTreeMap, rc::Rc};

use r4_log::{Live, LiveTopic};
use r4_protocol::{Mode, Setpoint};
use serde_json::Value;

use super::View;
use crate::{Error, Footprint, Place, Rig, Target, recording};

/// Messages by topic with their log times, ns.
type Seen = BTreeMap<String, Vec<(u64, Value)>>;

/// Live view that keeps what it is given.
#[derive(Default)]
struct Kept {
    names: BTreeMap<u16, (String, String)>,
    seen: Rc<RefCell<Seen>>,
}

impl Live for Kept {
    fn topic(&mut self, topic: &LiveTopic<'_>) {
        let schema: Value = serde_json::from_str(topic.json_schema).expect("a schema is JSON");
        assert_eq!(schema["type"], "object", "{}", topic.name);
        self.names.insert(topic.number, (topic.name.to_owned(), topic.json_schema.to_owned()));
    }

    fn message(&mut self, topic: u16, log_time_ns: u64, json: &[u8]) {
        let message: Value = serde_json::from_slice(json).expect("a message is JSON");
        let (name, schema) = &self.names[&topic];
        if matches!(name.as_str(), "/tf" | "/path" | "/scene") {
            keeps(&message, &serde_json::from_str(schema).expect("JSON"), name);
        }
        self.seen.borrow_mut().entry(name.clone()).or_default().push((log_time_ns, message));
    }
}

/// Checks that a message has exactly the fields and types of its schema.
fn keeps(message: &Value, schema: &Value, at: &str) {
    match schema["type"].as_str().expect("a type") {
        "object" => {
            let (fields, known) = (message.as_object().expect(at), schema["properties"].as_object().expect(at));
            assert!(fields.keys().eq(known.keys()), "{at}: {fields:?} {known:?}");
            for (name, value) in fields {
                keeps(value, &known[name], &format!("{at}.{name}"));
            }
        }
        "array" => message.as_array().expect(at).iter().for_each(|item| keeps(item, &schema["items"], at)),
        "number" => assert!(message.is_number(), "{at}"),
        "integer" => assert!(message.is_u64(), "{at}"),
        "string" => assert!(message.is_string(), "{at}"),
        "boolean" => assert!(message.is_boolean(), "{at}"),
        other => panic!("{at}: {other}"),
    }
}

/// Drives both sides of a simulated OpenScout at this speed for 2 s; returns what was seen live, and the true pose at the end.
fn driven(robot: &str, left_rad_s: f32, right_rad_s: f32) -> (Seen, Option<Place>) {
    let rig = Rig::new(Target::Sim(robot.to_owned()));
    let seen = Rc::<RefCell<Seen>>::default();
    let tap = |output| {
        let tap = recording::tap(&Target::Sim(robot.to_owned()), 1, "r4-rig".into(), "view".into(), output);
        tap.borrow_mut().tell(Box::new(Kept { seen: seen.clone(), ..Kept::default() }));
        tap
    };
    let recorded = rig.recorded(tap, async |session| {
        let channels: Vec<_> = session.board.channels().iter().map(|info| info.id).collect();
        for channel in &channels {
            session.board.subscribe(*channel, 10).await?;
        }
        if let Some(drive) = session.ground_drive() {
            let r4_boards::Drive::SkidSteer(drive) = drive.drive().clone() else { panic!("it steers by its sides") };
            session.board.arm().await?;
            for (side, value) in [(&drive.left, left_rad_s), (&drive.right, right_rad_s)] {
                for wheel in side {
                    session.board.set(*wheel, Setpoint { mode: Mode::Speed, value }).await?;
                }
            }
        }
        session.board.sleep_s(2.0).await;
        Ok::<_, Error>(session.true_place())
    });
    let place = recorded.result.expect("a session").0;
    drop(recorded.log);
    (seen.take(), place)
}

fn entity<'m>(scene: &'m Value, id: &str) -> Option<&'m Value> {
    scene["entities"].as_array()?.iter().find(|entity| entity["id"] == id)
}

#[test]
fn a_drive_is_seen_as_it_was() {
    let (seen, place) = driven("openscout", 6.0, 6.0);
    let place = place.expect("it has a body");
    let (times, transforms): (Vec<u64>, Vec<&Value>) = seen["/tf"].iter().map(|(ns, message)| (*ns, message)).unzip();
    // At most 20 a second, and each stamped with the time of its frame in the log.
    assert!((30..=41).contains(&times.len()), "{}", times.len());
    for (ns, message) in times.iter().zip(&transforms) {
        let stamp = &message["transforms"][0]["timestamp"];
        let (sec, nsec) = (stamp["sec"].as_u64().expect("sec"), stamp["nsec"].as_u64().expect("nsec"));
        assert_eq!(sec * 1_000_000_000 + nsec, *ns);
    }
    let [to_base, to_odom] = [0, 1].map(|at| &transforms[transforms.len() - 1]["transforms"][at]);
    assert_eq!((&to_base["parent_frame_id"], &to_base["child_frame_id"]), (&"odom".into(), &"base_link".into()));
    assert_eq!((&to_odom["parent_frame_id"], &to_odom["child_frame_id"]), (&"world".into(), &"odom".into()));
    let x_m = |transform: &Value| transform["translation"]["x"].as_f64().expect("x");
    let seen_m = x_m(to_base) + x_m(to_odom);
    // Straight ahead the wheels slip by little: 1 % of 1 m, and a frame of 50 ms at 0.6 m/s.
    assert!(seen_m > 0.5 && (seen_m - place.x_m).abs() < 0.04, "{seen_m} {}", place.x_m);
    let (way_ns, way) = seen["/path"].last().expect("a way");
    let poses = way["poses"].as_array().expect("poses");
    let last_m = poses[poses.len() - 1]["position"]["x"].as_f64().expect("x");
    let then = times.iter().position(|ns| ns == way_ns).expect("a transform of that frame");
    let then_m = x_m(&transforms[then]["transforms"][0]);
    // The next pose is added at 5 cm; 20 samples a second at 0.6 m/s are 3 cm apart.
    assert!(poses.len() > 5 && (0.0..0.09).contains(&(then_m - last_m)), "{} {then_m} {last_m}", poses.len());
    // The robot is drawn at once and then each second, rays and the true outline always.
    let scenes: Vec<&Value> = seen["/scene"].iter().map(|(_, message)| message).collect();
    let with = |id: &str| scenes.iter().filter(|scene| entity(scene, id).is_some()).count();
    assert_eq!((with("movable"), with("ranges")), (scenes.len(), scenes.len()));
    assert_eq!(with("robot"), 2);
    let truth = &entity(scenes[scenes.len() - 1], "movable").expect("there")["lines"][0]["pose"]["position"];
    assert!((truth["x"].as_f64().expect("x") - place.x_m).abs() < 0.04, "{truth}");
}

#[test]
fn a_long_way_is_shown_from_its_start_in_a_bounded_message() {
    let footprint = Footprint::of(&r4_boards::load("openscout").expect("built in")).expect("it drives");
    let mut view = View::new(footprint, Box::new(|| None));
    for centimetre in 0..100_000 {
        view.advance(Place { x_m: f64::from(centimetre) * 0.01, y_m: 0.0, yaw_rad: 0.0 });
    }
    let way_m: Vec<f64> = view.way.iter().map(|pose| pose.position.x).collect();
    let longest_m = way_m.windows(2).map(|pair| pair[1] - pair[0]).fold(0.0, f64::max);
    // 1000 m in at most 512 poses: 0.05 m and up to one sample of 1 cm, both doubled six times.
    assert!(way_m.len() <= 512 && way_m.len() > 256 && longest_m <= 3.84 + 1e-9, "{} {longest_m}", way_m.len());
    assert!(way_m[0] == 0.0 && way_m[way_m.len() - 1] > 1000.0 - 3.85, "{way_m:?}");
}

#[test]
fn a_board_without_wheels_has_no_view() {
    let (seen, _) = driven("osmc-bench", 0.0, 0.0);
    assert!(seen.contains_key("/osmc0") && !seen.contains_key("/tf"), "{:?}", seen.keys());
}
