//! The sums of an azimuth sector in about half the bytes, exactly, while no observation comes from there.
//!
//! A row is its least sum and what the others are above it, in as few bits as the greatest needs; of rows that are
//! all 0 nothing is held.

use echosplat_measurement::lanes::LANES;

use super::VOXELS;

/// Sums of one azimuth sector per voxel, z fastest, in steps of 1/64 up to 512: small, since there are many, and
/// exact enough for observations of ½.
pub(super) type SectorSums = [i16; VOXELS];

/// Bytes a row is read from; layout.
/// A row is read as one number of so many bytes.
const READ: usize = size_of::<u128>();

/// Rows that are not all 0, a bit each; then width, least sum and differences of each of these; then room to read on.
#[derive(Debug)]
pub(super) struct Packed(Box<[u8]>);

impl Packed {
    pub(super) fn of(sums: &SectorSums) -> Self {
        let (mut rows, mut bytes) = (0_u64, vec![0; size_of::<u64>()]);
        for (index, row) in sums.chunks_exact(LANES).enumerate() {
            if row.iter().all(|&sum| sum == 0) {
                continue;
            }
            rows |= 1 << index;
            let least = row.iter().copied().fold(i16::MAX, i16::min);
            let above = |sum: i16| sum.wrapping_sub(least).cast_unsigned();
            let most = row.iter().map(|&sum| above(sum)).fold(0, u16::max);
            let width = u16::BITS - most.leading_zeros();
            let together = |bits: u128, &sum: &i16| bits << width | u128::from(above(sum));
            let bits = row.iter().rev().fold(0, together);
            bytes.push(width as u8);
            bytes.extend(least.to_le_bytes());
            // Eight numbers of so many bits are as many bytes.
            bytes.extend(&bits.to_le_bytes()[..width as usize]);
        }
        bytes[..size_of::<u64>()].copy_from_slice(&rows.to_le_bytes());
        bytes.extend([0; READ]);
        Self(bytes.into_boxed_slice())
    }

    #[inline(always)]
    pub(super) fn unpack(&self) -> SectorSums {
        let mut sums = [0; VOXELS];
        let (rows, mut bytes) = self.0.split_at(size_of::<u64>());
        let mut rows = rows
            .iter()
            .rev()
            .fold(0_u64, |all, &byte| all << 8 | u64::from(byte));
        while rows > 0 {
            let row = rows.trailing_zeros() as usize * LANES;
            rows &= rows - 1;
            let (width, least) = (
                u32::from(bytes[0]),
                i16::from_le_bytes([bytes[1], bytes[2]]),
            );
            bytes = &bytes[3..];
            let mut read = [0; READ];
            read.copy_from_slice(&bytes[..READ]);
            bytes = &bytes[width as usize..];
            // In halves, which the processor's wide registers take whole.
            let bits = u128::from_le_bytes(read);
            let halves = [bits as u64, (bits >> (4 * width)) as u64];
            let mask = (1_u64 << width) - 1;
            for (half, sums) in halves
                .into_iter()
                .zip(sums[row..row + LANES].chunks_exact_mut(4))
            {
                for (place, sum) in sums.iter_mut().enumerate() {
                    let above = half >> (place as u32 * width) & mask;
                    *sum = least.wrapping_add(above as i16);
                }
            }
        }
        sums
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn sums_come_back_as_they_were() {
        let mut sums = [0; VOXELS];
        assert_eq!(Packed::of(&sums).unpack(), sums);
        for width in 0..=16 {
            // Rows of nothing, of one number, at the ends of the numbers, and of all widths.
            for (voxel, sum) in sums.iter_mut().enumerate() {
                let spread = (voxel * 7919 % 65_536) as u32 & ((1 << width) - 1);
                *sum = match voxel / LANES % 4 {
                    0 => 0,
                    1 => i16::MIN.wrapping_add(spread as i16),
                    2 => i16::MAX.wrapping_sub(spread as i16),
                    _ => width as i16 - 5,
                };
            }
            assert_eq!(Packed::of(&sums).unpack(), sums, "{width}");
        }
        sums[0] = i16::MIN;
        sums[7] = i16::MAX;
        assert_eq!(Packed::of(&sums).unpack(), sums);
    }

    #[test]
    fn smooth_sums_take_about_half_the_room() {
        let sums = std::array::from_fn(|voxel| -900 - 10 * (voxel % 8) as i16);
        let packed = Packed::of(&sums);
        assert!(
            packed.0.len() < size_of::<SectorSums>() * 3 / 4,
            "{}",
            packed.0.len()
        );
    }
}
