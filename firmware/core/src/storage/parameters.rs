//! Changed parameters: the differences from the built-in configuration, and their storage.
//!
//! All changes are one item, so that a save happens completely or not at all:
//!
//! ```text
//! layout: u8 | robot it was made for | new name, if any | length: u8, key and value | length: u8, key and value ...
//! ```
//!
//! A value takes 9 bytes, so that a sector of 128 KiB holds 400 saves of 20 changes, or 60 of the maximum number. Two
//! sectors of 10 000 erases then last for more than a million saves.

use embedded_storage_async::nor_flash::NorFlash;
use heapless::{String, Vec};
use r4_protocol::{ParameterKey, config::BoardConfig};

use super::{
    log::{StorageError, parameter_log},
    words::DATA_BYTES,
};

/// Maximum number of changed values.
pub const MAX_CHANGES: usize = 192;

/// Maximum size of a key and its value, bytes: an optional channel of two bytes, a parameter of up to two, an `f32`.
const MAX_ENTRY: usize = 9;
/// Maximum size of an item, bytes; both names have a length of one byte, and the second may be absent.
const MAX_ITEM: usize = 1 + 33 + 34 + MAX_CHANGES * (1 + MAX_ENTRY);
const BUFFER: usize = MAX_ITEM.next_multiple_of(DATA_BYTES);

type Item = Vec<u8, MAX_ITEM>;

/// Conversion from one layout to the next: rewrites what follows the layout's number; `None` if that cannot be
/// interpreted.
type Step = fn(&[u8], &mut Item) -> Option<()>;

/// Oldest layout that has existed.
const FIRST_LAYOUT: u8 = 1;
/// Conversions from each layout to the next. Add one with each new layout, and leave the earlier ones unchanged.
const STEPS: [Step; 0] = [];
/// Layout that this firmware writes.
const LAYOUT: u8 = FIRST_LAYOUT + STEPS.len() as u8;

/// Differences from the built-in configuration.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Changes {
    /// Changed name of the robot; `None` if unchanged.
    pub robot: Option<String<32>>,
    /// Changed values, each key once.
    pub values: Vec<(ParameterKey, f32), MAX_CHANGES>,
}

/// Error: more than [`MAX_CHANGES`] values would differ. Nothing was changed.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct TooManyChanges;

impl Changes {
    /// Returns the differences of `changed` from `built_in`.
    ///
    /// # Errors
    /// [`TooManyChanges`] for more than [`MAX_CHANGES`] of them.
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

    /// Records `value` for `key`; a value equal to the built-in one removes the change.
    ///
    /// # Errors
    /// [`TooManyChanges`] when there is no room for another change.
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

    /// Applies the changes to `config`, and moves those that are not possible to `skipped`.
    fn apply(&mut self, config: &mut BoardConfig, skipped: &mut Skipped) {
        if let Some(robot) = &self.robot {
            config.robot = robot.clone();
        }
        if config.set_parameters(self.values.iter().copied()).is_ok() {
            return;
        }
        // Some value does not fit. Tried one by one, in several rounds: a value may require another to be set before
        // it.
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

/// Saved values that are not used: the configuration does not have them, or would be invalid with them.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Skipped {
    /// Number of skipped values.
    pub count: u16,
    /// First skipped values, of those whose key this firmware knows.
    pub first: Vec<(ParameterKey, f32), 8>,
}

impl Skipped {
    fn add(&mut self, value: Option<(ParameterKey, f32)>) {
        self.count += 1;
        if let Some(value) = value {
            // Counted even when there is no room.
            let _ = self.first.push(value);
        }
    }
}

/// Contents of the flash.
#[derive(Clone, Debug, PartialEq)]
pub enum Saved {
    /// Blank flash: parameters have never been saved.
    Nothing,
    /// The changes in [`Loaded::changes`].
    Changes,
    /// Changes for another robot, the one with this built-in name. They stay until the next save.
    OtherRobot(String<32>),
    /// Changes in a layout of a newer firmware. They stay until the next save.
    NewerLayout(u8),
    /// Contents that cannot be interpreted. They stay until the next save.
    Damaged,
}

/// Configuration to start with, and its origin.
#[derive(Clone, Debug, PartialEq)]
pub struct Loaded {
    /// Built-in configuration with `changes` applied.
    pub config: BoardConfig,
    /// Saved changes that are used.
    pub changes: Changes,
    /// State of the saved changes.
    pub saved: Saved,
    /// Saved changes that are not used; the next save discards them.
    pub skipped: Skipped,
}

/// Reads the saved changes and applies them to `built_in`. For any contents of the flash there is a configuration to
/// start with, which is valid if `built_in` is.
///
/// Its state takes 10 KiB, the result included; on the stack, 2.5 KiB for a copy of the configuration.
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

/// Saves `changes` for the robot whose built-in name is `made_for`. Empty changes restore the built-in values.
///
/// # Errors
/// [`StorageError`] when the flash fails; the previous save is then still there, unless it was damaged.
pub async fn save<F: NorFlash>(flash: &mut F, made_for: &str, changes: &Changes) -> Result<(), StorageError> {
    let mut buffer = [0; BUFFER];
    let item = encode(made_for, changes).ok_or(StorageError::Damaged)?;
    parameter_log(flash).push(&item, &mut buffer).await
}

/// Encodes an item; `None` for a name that is too long.
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

/// Decodes an item into the robot that it was made for and the changes; `None` if the bytes cannot be interpreted.
fn decode(item: &[u8], skipped: &mut Skipped) -> Option<(String<32>, Changes)> {
    let ((made_for, robot), mut entries) = postcard::take_from_bytes::<(_, Option<String<32>>)>(item.get(1..)?).ok()?;
    let mut changes = Changes { robot, values: Vec::new() };
    while let Some((length, rest)) = entries.split_first() {
        let (entry, rest) = rest.split_at_checked((*length).into())?;
        entries = rest;
        match postcard::from_bytes::<(ParameterKey, f32)>(entry) {
            Ok((key, value)) => changes.values.push((key, value)).ok()?,
            // The channel or parameter belongs to another firmware.
            Err(_) => skipped.add(None),
        }
    }
    Some((made_for, changes))
}

/// Converts `item` from any earlier layout to the one behind the last of `steps`.
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

    /// Bytes of layout 1 in flash. They must never change: a new layout gets a new number and a conversion.
    const LAYOUT_1: &[u8] = b"\x01\x05bench\x01\x03Ada\x08\x01\x00\x01\x08\0\0\0\x40\x06\0\0\0\0\x7A\x43";

    #[test]
    fn layout_1_stays_what_it_is() {
        assert_eq!(encode("bench", &changes()).as_deref(), Some(LAYOUT_1));
        let mut skipped = Skipped::default();
        assert_eq!(decode(LAYOUT_1, &mut skipped), Some((String::try_from("bench").expect("fits"), changes())));
        assert_eq!(skipped.count, 0);
    }

    /// Name and values are found as changes, separately and together; equal ones are not.
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
            // Bytes that end between two values are a valid, shorter item.
            assert_eq!(decoded.is_some(), [12, 21].contains(&end), "{end} bytes");
        }
    }

    /// Converts from a layout 0 without names, made for this test: values only.
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

        // Two conversions, starting from the first and from the second layout.
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
