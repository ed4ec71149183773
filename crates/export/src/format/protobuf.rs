//! Protocol buffers as far as ONNX needs them: fields of varints, floats, text and messages, written in order.

/// A message while it is written.
#[derive(Clone, Default)]
pub(crate) struct Message(pub(crate) Vec<u8>);

impl Message {
    fn varint(&mut self, mut x: u64) {
        while x >= 0x80 {
            self.0.push((x as u8 & 0x7f) | 0x80);
            x >>= 7;
        }
        self.0.push(x as u8);
    }

    /// An integer field.
    pub(crate) fn int(mut self, field: u32, x: i64) -> Self {
        self.varint(u64::from(field) << 3);
        self.varint(x.cast_unsigned());
        self
    }

    /// A field of bytes.
    pub(crate) fn bytes(mut self, field: u32, data: &[u8]) -> Self {
        self.varint(u64::from(field) << 3 | 2);
        self.varint(data.len() as u64);
        self.0.extend_from_slice(data);
        self
    }

    /// A text field.
    pub(crate) fn text(self, field: u32, text: &str) -> Self {
        self.bytes(field, text.as_bytes())
    }

    /// A field that is a message.
    pub(crate) fn message(self, field: u32, inner: &Message) -> Self {
        self.bytes(field, &inner.0)
    }

    /// Several of them.
    pub(crate) fn messages(self, field: u32, inner: &[Message]) -> Self {
        inner.iter().fold(self, |m, i| m.message(field, i))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The example of the encoding's own documentation: field 1 with 150 is 08 96 01.
    #[test]
    fn varint_as_documented() {
        assert_eq!(Message::default().int(1, 150).0, [0x08, 0x96, 0x01]);
        assert_eq!(Message::default().text(2, "testing").0, b"\x12\x07testing");
    }
}
