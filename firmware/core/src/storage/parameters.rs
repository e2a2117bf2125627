//! What differs from the built-in configuration, and how it is saved.
//!
//! All changes are one item, so that a save happens or does not:
//!
//! ```text
//! layout: u8 | robot it was made for | new name, if any | length: u8, key and value | length: u8, key and value ...
//! ```
//!
//! A value takes 9 bytes, so that a sector of 128 KiB takes 400 saves of 20 changes and 60 of the most there can be. Two
//! sectors of 10 000 erases then last for more than a million saves.

use embedded_storage_async::nor_flash::NorFlash;
use heapless::{String, Vec};
use r4_protocol::{ParameterKey, config::BoardConfig};

use super::{StorageError, parameter_log, words::DATA_BYTES};

/// Most numbers that can differ.
pub const MAX_CHANGES: usize = 192;

/// Most bytes of a key and its value: an optional channel of two bytes, a parameter of up to two, an `f32`.
const MAX_ENTRY: usize = 9;
/// Most bytes of an item; both names have a length of one byte, and the second may be absent.
const MAX_ITEM: usize = 1 + 33 + 34 + MAX_CHANGES * (1 + MAX_ENTRY);
const BUFFER: usize = MAX_ITEM.next_multiple_of(DATA_BYTES);

type Item = Vec<u8, MAX_ITEM>;

/// Rewrites what follows the layout's number from one layout to the next; `None` if it makes no sense.
type Step = fn(&[u8], &mut Item) -> Option<()>;

/// The oldest layout there has been.
const FIRST_LAYOUT: u8 = 1;
/// From each layout to the next. Add one with each new layout, and leave those before it alone.
const STEPS: [Step; 0] = [];
/// What this firmware writes.
const LAYOUT: u8 = FIRST_LAYOUT + STEPS.len() as u8;

/// What differs from the built-in configuration.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Changes {
    /// The robot's name.
    pub robot: Option<String<32>>,
    /// Numbers, each key once.
    pub values: Vec<(ParameterKey, f32), MAX_CHANGES>,
}

/// More than [`MAX_CHANGES`] numbers would differ. Nothing was changed.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct TooManyChanges;

impl Changes {
    /// What makes `changed` of `built_in`.
    ///
    /// # Errors
    /// [`TooManyChanges`]
    pub fn between(built_in: &BoardConfig, changed: &BoardConfig) -> Result<Self, TooManyChanges> {
        let robot = (changed.robot != built_in.robot).then(|| changed.robot.clone());
        let mut changes = Self { robot, ..Self::default() };
        for key in changed.parameters() {
            if let Some(value) = changed.parameter(key) {
                changes.set(built_in, key, value)?;
            }
        }
        Ok(changes)
    }

    /// Notes that `key` is now `value`; what is as built in is no change.
    ///
    /// # Errors
    /// [`TooManyChanges`]
    pub fn set(&mut self, built_in: &BoardConfig, key: ParameterKey, value: f32) -> Result<(), TooManyChanges> {
        let place = self.values.iter().position(|(known, _)| *known == key);
        match (place, built_in.parameter(key) == Some(value)) {
            (Some(place), true) => {
                self.values.remove(place);
            }
            (Some(place), false) => self.values[place].1 = value,
            (None, true) => {}
            (None, false) => self.values.push((key, value)).map_err(|_| TooManyChanges)?,
        }
        Ok(())
    }

    /// Puts the changes into `config` and takes out those that cannot be.
    fn apply(&mut self, config: &mut BoardConfig, skipped: &mut Skipped) {
        if let Some(robot) = &self.robot {
            config.robot = robot.clone();
        }
        if config.set_parameters(self.values.iter().copied()).is_ok() {
            return;
        }
        // Something does not fit. One by one, and again: one number may need another to be set before it.
        const ROUNDS: usize = 3;
        let mut refused = self.values.clone();
        for _ in 0..ROUNDS {
            refused.retain(|(key, value)| config.set_parameter(*key, *value).is_err());
        }
        self.values.retain(|(key, _)| refused.iter().all(|(other, _)| other != key));
        for (key, value) in refused {
            skipped.add(Some((key, value)));
        }
    }
}

/// Saved numbers that are not used: the configuration does not have them, or would not be valid with them.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Skipped {
    /// How many.
    pub count: u16,
    /// The first of those that this firmware has a name for.
    pub first: Vec<(ParameterKey, f32), 8>,
}

impl Skipped {
    fn add(&mut self, value: Option<(ParameterKey, f32)>) {
        self.count += 1;
        if let Some(value) = value {
            // Counted all the same when there is no room.
            let _ = self.first.push(value);
        }
    }
}

/// What flash held.
#[derive(Clone, Debug, PartialEq)]
pub enum Saved {
    /// Nothing: parameters have never been saved.
    Nothing,
    /// The changes in [`Loaded::changes`].
    Changes,
    /// Changes for another robot, the one with this built-in name. They stay until something is saved.
    OtherRobot(String<32>),
    /// Changes in a layout of a newer firmware. They stay until something is saved.
    NewerLayout(u8),
    /// Something that makes no sense. It stays until something is saved.
    Damaged,
}

/// The configuration to start with.
#[derive(Clone, Debug, PartialEq)]
pub struct Loaded {
    /// The built-in one with `changes`.
    pub config: BoardConfig,
    /// Those that were saved and are used.
    pub changes: Changes,
    /// Whether they were there.
    pub saved: Saved,
    /// Those that were saved and are not used; the next save forgets them.
    pub skipped: Skipped,
}

/// Reads what was saved and puts it into `built_in`. Whatever flash holds, there is a configuration to start with, and it is
/// valid if `built_in` is.
///
/// Its state takes 10 KiB, the result included; of stack, 2.5 KiB for a copy of the configuration.
pub async fn load<F: NorFlash>(flash: &mut F, built_in: &BoardConfig) -> Loaded {
    let mut loaded = Loaded {
        config: built_in.clone(),
        changes: Changes::default(),
        saved: Saved::Nothing,
        skipped: Skipped::default(),
    };
    let mut newest = None;
    let mut buffer = [0; BUFFER];
    let seen = parameter_log(flash).visit(&mut buffer, |item| newest = Some(Item::from_slice(item))).await;
    let mut item = match (seen, newest) {
        (Ok(()), Some(Ok(item))) => item,
        (Ok(()), None) if parameter_log(flash).is_blank().await => return loaded,
        _ => {
            loaded.saved = Saved::Damaged;
            return loaded;
        }
    };
    loaded.saved = match upgrade(&mut item, FIRST_LAYOUT, &STEPS) {
        Ok(()) => match decode(&item, &mut loaded.skipped) {
            Some((made_for, changes)) if made_for == built_in.robot => {
                loaded.changes = changes;
                Saved::Changes
            }
            Some((made_for, _)) => Saved::OtherRobot(made_for),
            None => Saved::Damaged,
        },
        Err(saved) => saved,
    };
    if loaded.saved == Saved::Changes {
        loaded.changes.apply(&mut loaded.config, &mut loaded.skipped);
    } else {
        loaded.skipped = Skipped::default();
    }
    loaded
}

/// Saves `changes` for the robot whose built-in name is `made_for`. No changes go back to what is built in.
///
/// # Errors
/// [`StorageError`]; what was saved before is then still there, unless it was damaged.
pub async fn save<F: NorFlash>(flash: &mut F, made_for: &str, changes: &Changes) -> Result<(), StorageError> {
    let mut buffer = [0; BUFFER];
    let item = encode(made_for, changes).ok_or(StorageError::Damaged)?;
    parameter_log(flash).push(&item, &mut buffer).await
}

/// `None` for a name that is too long.
fn encode(made_for: &str, changes: &Changes) -> Option<Item> {
    let made_for = String::<32>::try_from(made_for).ok()?;
    let mut item = Item::new();
    item.push(LAYOUT).ok()?;
    let mut bytes = [0; 33 + 34];
    item.extend_from_slice(postcard::to_slice(&(made_for, &changes.robot), &mut bytes).ok()?).ok()?;
    for entry in &changes.values {
        let entry = postcard::to_slice(entry, &mut bytes[..MAX_ENTRY]).ok()?;
        item.push(entry.len() as u8).ok()?;
        item.extend_from_slice(entry).ok()?;
    }
    Some(item)
}

/// The robot it was made for, and the changes; `None` if the bytes make no sense.
fn decode(item: &[u8], skipped: &mut Skipped) -> Option<(String<32>, Changes)> {
    let ((made_for, robot), mut entries) = postcard::take_from_bytes::<(_, Option<String<32>>)>(item.get(1..)?).ok()?;
    let mut changes = Changes { robot, values: Vec::new() };
    while let Some((length, rest)) = entries.split_first() {
        let (entry, rest) = rest.split_at_checked((*length).into())?;
        entries = rest;
        match postcard::from_bytes::<(ParameterKey, f32)>(entry) {
            Ok((key, value)) => changes.values.push((key, value)).ok()?,
            // A channel or parameter that another firmware knows.
            Err(_) => skipped.add(None),
        }
    }
    Some((made_for, changes))
}

/// Brings `item` from any earlier layout to the one behind the last of `steps`.
fn upgrade(item: &mut Item, first_layout: u8, steps: &[Step]) -> Result<(), Saved> {
    let newest = first_layout + steps.len() as u8;
    let layout = *item.first().ok_or(Saved::Damaged)?;
    if layout > newest {
        return Err(Saved::NewerLayout(layout));
    }
    let done = layout.checked_sub(first_layout).ok_or(Saved::Damaged)?;
    for (step, layout) in steps.iter().skip(done.into()).zip(layout + 1..) {
        let mut next = Item::new();
        next.push(layout).map_err(|_| Saved::Damaged)?;
        step(&item[1..], &mut next).ok_or(Saved::Damaged)?;
        *item = next;
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use r4_protocol::{ChannelId, ChannelKind, Parameter};

    use super::*;

    fn changes() -> Changes {
        let gain =
            ParameterKey { channel: Some(ChannelId::new(ChannelKind::Osmc, 1)), parameter: Parameter::PositionKp };
        let board = ParameterKey { channel: None, parameter: Parameter::LinkTimeoutMs };
        let values = Vec::from_slice(&[(gain, 2.0), (board, 250.0)]).expect("fits");
        Changes { robot: Some(String::try_from("Ada").expect("fits")), values }
    }

    /// Layout 1 as it is in flash. It must never change: a new layout gets a new number and a step.
    const LAYOUT_1: &[u8] = b"\x01\x05bench\x01\x03Ada\x08\x01\x00\x01\x08\0\0\0\x40\x06\0\0\0\0\x7A\x43";

    #[test]
    fn layout_1_stays_what_it_is() {
        assert_eq!(encode("bench", &changes()).as_deref(), Some(LAYOUT_1));
        let mut skipped = Skipped::default();
        assert_eq!(decode(LAYOUT_1, &mut skipped), Some((String::try_from("bench").expect("fits"), changes())));
        assert_eq!(skipped.count, 0);
    }

    /// Name and numbers, each by itself and together; what is the same is none.
    #[test]
    fn changes_are_what_differs() {
        let built_in = crate::testing::robot("osmc-bench");
        let key = ParameterKey { channel: None, parameter: Parameter::LinkTimeoutMs };
        let name = String::try_from("Ada").expect("fits");
        for (robot, value) in [(None, None), (Some(&name), None), (None, Some(250.0)), (Some(&name), Some(250.0))] {
            let mut changed = built_in.clone();
            robot.into_iter().for_each(|name| changed.robot = name.clone());
            value.into_iter().for_each(|value| changed.set_parameter(key, value).expect("valid"));
            let expected =
                Changes { robot: robot.cloned(), values: value.into_iter().map(|value| (key, value)).collect() };
            assert_eq!(Changes::between(&built_in, &changed), Ok(expected));
        }
    }

    #[test]
    fn the_most_there_can_be_fits() {
        let name = "12345678901234567890123456789012";
        let key = ParameterKey {
            channel: Some(ChannelId::new(ChannelKind::DeadMan, 255)),
            parameter: Parameter::all().last().expect("some"),
        };
        let mut all = Changes { robot: Some(String::try_from(name).expect("fits")), values: Vec::new() };
        while all.values.push((key, f32::MAX)).is_ok() {}
        let item = encode(name, &all).expect("fits");
        assert_eq!(decode(&item, &mut Skipped::default()).map(|(_, decoded)| decoded), Some(all));
    }

    #[test]
    fn a_key_of_another_firmware_is_skipped_and_the_rest_is_not() {
        // Parameter 0x7F of channel kind 0x7E, between the name and the gain.
        let mut item = Item::from_slice(&LAYOUT_1[..12]).expect("fits");
        item.extend_from_slice(b"\x08\x01\x7E\x00\x7F\0\0\0\x40").expect("fits");
        item.extend_from_slice(&LAYOUT_1[12..]).expect("fits");
        let mut skipped = Skipped::default();
        assert_eq!(decode(&item, &mut skipped).map(|(_, decoded)| decoded), Some(changes()));
        assert_eq!(skipped, Skipped { count: 1, first: Vec::new() });
    }

    #[test]
    fn bytes_that_end_too_soon_are_refused() {
        for end in 0..LAYOUT_1.len() {
            let decoded = decode(&LAYOUT_1[..end], &mut Skipped::default());
            // What ends between two values is one that was written so.
            assert_eq!(decoded.is_some(), [12, 21].contains(&end), "{end} bytes");
        }
    }

    /// A layout 0 without names, made for this test: values only.
    fn from_0(old: &[u8], new: &mut Item) -> Option<()> {
        new.extend_from_slice(b"\x05bench\0").ok()?;
        new.extend_from_slice(old).ok()
    }

    #[test]
    fn an_old_layout_is_brought_up_step_by_step() {
        let mut item = Item::from_slice(b"\0").expect("fits");
        item.extend_from_slice(&LAYOUT_1[12..]).expect("fits");
        assert_eq!(upgrade(&mut item, 0, &[from_0]), Ok(()));
        let expected = Changes { robot: None, ..changes() };
        assert_eq!(decode(&item, &mut Skipped::default()).map(|(_, decoded)| decoded), Some(expected));

        // Two steps, from the first and from the second layout.
        let second: Step = |old, new| {
            new.extend_from_slice(old).ok()?;
            new.push(0xAA).ok()
        };
        for (start, expected) in [(&b"\0"[..], &b"\x02\x05bench\0\xAA"[..]), (b"\x01old", b"\x02old\xAA")] {
            let mut item = Item::from_slice(start).expect("fits");
            assert_eq!(upgrade(&mut item, 0, &[from_0, second]), Ok(()));
            assert_eq!(item, expected);
        }
    }

    #[test]
    fn layouts_that_this_firmware_does_not_know_are_told_apart() {
        let mut newer = Item::from_slice(&[LAYOUT + 1]).expect("fits");
        assert_eq!(upgrade(&mut newer, FIRST_LAYOUT, &STEPS), Err(Saved::NewerLayout(LAYOUT + 1)));
        let mut older = Item::from_slice(&[FIRST_LAYOUT - 1]).expect("fits");
        assert_eq!(upgrade(&mut older, FIRST_LAYOUT, &STEPS), Err(Saved::Damaged));
        assert_eq!(upgrade(&mut Item::new(), FIRST_LAYOUT, &STEPS), Err(Saved::Damaged));
    }
}
