//! The fields of a message of Protocol Buffers, one after another, as its wire format has them.

/// The value of a field.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Field<'a> {
    /// A varint.
    Number(u64),
    /// Eight bytes, as a double has.
    Eight(u64),
    /// A text, or a message in the message.
    Bytes(&'a [u8]),
    /// Four bytes, as a float has.
    Four(u32),
}

/// Each field's number and value; ends at the first that is none.
pub(super) fn fields(message: &[u8]) -> impl Iterator<Item = Result<(u64, Field<'_>), String>> {
    let mut rest = Some(message);
    std::iter::from_fn(move || {
        let at_hand = rest.take().filter(|bytes| !bytes.is_empty())?;
        Some(match field(at_hand) {
            Some((number, value, behind)) => {
                rest = Some(behind);
                Ok((number, value))
            }
            None => Err("a message of Protocol Buffers that is cut or damaged".to_owned()),
        })
    })
}

fn field(bytes: &[u8]) -> Option<(u64, Field<'_>, &[u8])> {
    let (tag, rest) = varint(bytes)?;
    let (value, rest) = match tag & 7 {
        0 => {
            let (number, rest) = varint(rest)?;
            (Field::Number(number), rest)
        }
        1 => {
            let (eight, rest) = rest.split_first_chunk()?;
            (Field::Eight(u64::from_le_bytes(*eight)), rest)
        }
        2 => {
            let (length, rest) = varint(rest)?;
            let (bytes, rest) = rest.split_at_checked(usize::try_from(length).ok()?)?;
            (Field::Bytes(bytes), rest)
        }
        5 => {
            let (four, rest) = rest.split_first_chunk()?;
            (Field::Four(u32::from_le_bytes(*four)), rest)
        }
        _ => return None,
    };
    Some((tag >> 3, value, rest))
}

/// Seven bits a byte, the least first, the highest bit of each but the last set.
fn varint(bytes: &[u8]) -> Option<(u64, &[u8])> {
    let length = bytes.iter().take(10).position(|byte| byte & 0x80 == 0)? + 1;
    let (number, rest) = bytes.split_at(length);
    let add = |sum: u64, byte: &u8| (sum << 7) | u64::from(byte & 0x7f);
    Some((number.iter().rev().fold(0, add), rest))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn fields_of_each_kind_are_read_in_order_and_a_cut_is_told() {
        let message = [
            &[
                0x08, 0x96, 0x01, 0x12, 2, b'h', b'i', 0x1d, 1, 0, 0, 0, 0x21,
            ][..],
            &[0; 8],
        ]
        .concat();
        let found: Vec<_> = fields(&message).map(Result::unwrap).collect();
        let expected = [
            (1, Field::Number(150)),
            (2, Field::Bytes(b"hi")),
            (3, Field::Four(1)),
            (4, Field::Eight(0)),
        ];
        assert_eq!(found, expected);
        assert!(fields(&message[..6]).last().unwrap().is_err());
        assert!(fields(&[0xff; 12]).last().unwrap().is_err());
    }
}
