//! Configuration of the robot that an image is for, at [`ROBOT_AT`].

use r4_protocol::{
    config::BoardConfig,
    image::{ROBOT_AT, ROBOT_BYTES},
};

use crate::{Binary, ImageError};

/// Writes the configuration of a robot into an ELF file that was just linked, over that of another robot on the same
/// carrier. The record of the image is then out of date: call [`seal_elf`](crate::seal_elf) next.
///
/// # Errors
/// [`ImageError::RobotTooLarge`] if it does not fit, [`ImageError::NoRobot`] if the firmware has no place for it, and
/// the errors of [`Binary::of`]. The file is then unchanged.
pub fn set_robot(elf: &mut [u8], config: &BoardConfig) -> Result<(), ImageError> {
    let address = Binary::of(elf)?.start.wrapping_add(ROBOT_AT as u32);
    let place = Binary::offset_in(elf, address).and_then(|at| elf.get_mut(at..)?.get_mut(..ROBOT_BYTES));
    let place = place.ok_or(ImageError::NoRobot { address })?;
    let mut packed = [0xFF; ROBOT_BYTES];
    postcard::to_slice(config, &mut packed).map_err(|_| ImageError::RobotTooLarge { room: ROBOT_BYTES })?;
    place.copy_from_slice(&packed);
    Ok(())
}

#[cfg(test)]
mod tests {
    use r4_protocol::image::CODE_AT;

    use super::*;
    use crate::binary::tests::elf;

    /// Offset of the image in the ELF file: headers of 52 and 32 bytes are in front.
    const IMAGE: usize = 84;

    /// ELF file of an image of `bytes` zeros at 0x0800_0000.
    fn linked(bytes: usize) -> Vec<u8> {
        elf(&[(1, 0x0800_0000, &vec![0; bytes])])
    }

    #[test]
    fn each_built_in_robot_has_room_and_nothing_else_changes() {
        for name in r4_boards::names() {
            let config = r4_boards::load(name).expect("built in").config;
            let mut elf = linked(CODE_AT + 32);
            // The place has another robot's configuration before.
            elf[IMAGE + ROBOT_AT..IMAGE + CODE_AT].fill(0x5A);
            set_robot(&mut elf, &config).expect("there is room");
            let (before, after) = (&elf[IMAGE..IMAGE + ROBOT_AT], &elf[IMAGE + CODE_AT..]);
            assert!(before.iter().chain(after).all(|byte| *byte == 0), "{name}");
            let (read, rest) =
                postcard::take_from_bytes::<BoardConfig>(&elf[IMAGE + ROBOT_AT..IMAGE + CODE_AT]).expect(name);
            assert_eq!(read, config);
            assert!(rest.iter().all(|byte| *byte == 0xFF), "{name}: {} bytes left", rest.len());
        }
    }

    #[test]
    fn an_image_without_the_place_is_left_as_it_is() {
        let config = r4_boards::load("osmc-bench").expect("built in").config;
        let mut elf = linked(CODE_AT - 1);
        let before = elf.clone();
        assert_eq!(set_robot(&mut elf, &config), Err(ImageError::NoRobot { address: 0x0800_0400 }));
        assert_eq!(elf, before);
    }
}
