//! What Takt orders.

use super::bytes::{Reader, Writer};

const STATUS: u16 = 1;

/// An order.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Order {
    /// Tell how the programs stand (part 0), or the tasks from `(part - 1) * TASKS_EACH` on.
    Status {
        /// Which part.
        part: u16,
    },
}

impl Order {
    /// Writes it, with its number; `None` if it has no room.
    #[must_use]
    pub fn encode<'b>(&self, number: u32, buffer: &'b mut [u8]) -> Option<&'b [u8]> {
        let mut to = Writer::new(buffer);
        let kind = match self {
            Order::Status { .. } => STATUS,
        };
        to.u16(kind);
        to.u16(0);
        to.u32(number);
        match *self {
            Order::Status { part } => to.u16(part),
        }
        to.end()
    }
}

/// Reads an order and its number. An order that is none has a number if it is long enough for one.
///
/// # Errors
/// The number of a message that is no order, if it has one.
pub fn decode_order(message: &[u8]) -> Result<(u32, Order), Option<u32>> {
    let mut from = Reader(message);
    let head = (from.u16(), from.u16(), from.u32());
    let (Some(kind), Some(zero), Some(number)) = head else { return Err(None) };
    let order = if zero == 0 { body(kind, &mut from) } else { None };
    order.map(|order| (number, order)).ok_or(Some(number))
}

fn body(kind: u16, from: &mut Reader<'_>) -> Option<Order> {
    match kind {
        STATUS => {
            let part = from.u16()?;
            from.end(Order::Status { part })
        }
        _ => None,
    }
}

#[cfg(test)]
mod tests {
    use super::super::MESSAGE_BYTES;
    use super::*;

    #[test]
    fn an_order_is_read_as_it_was_written_and_no_part_of_it_is_one() {
        let mut buffer = [0; MESSAGE_BYTES];
        let order = Order::Status { part: 7 };
        let message = order.encode(9, &mut buffer).unwrap();
        assert_eq!(decode_order(message), Ok((9, order)));
        for length in 0..message.len() {
            let number = (length >= 8).then_some(9);
            assert_eq!(decode_order(&message[..length]), Err(number));
        }
        let mut longer = message.to_vec();
        longer.push(0);
        assert_eq!(decode_order(&longer), Err(Some(9)));
        assert_eq!(order.encode(9, &mut [0; 9]), None);
    }
}
