//! Writes the subset of Protocol Buffers that an ONNX graph needs.
//!
//! **Source**: Protocol Buffers, "Encoding".

/// A message under construction.
#[derive(Clone, Debug, Default)]
pub(super) struct ProtobufMessage(Vec<u8>);

/// Wire types of fields.
const VARINT: u64 = 0;
const BYTES: u64 = 2;

impl ProtobufMessage {
    /// Adds an unsigned whole number.
    pub(super) fn number(mut self, field: u64, value: u64) -> Self {
        self.varint(field << 3 | VARINT);
        self.varint(value);
        self
    }

    /// Adds bytes or text.
    pub(super) fn bytes(mut self, field: u64, bytes: impl AsRef<[u8]>) -> Self {
        let bytes = bytes.as_ref();
        self.varint(field << 3 | BYTES);
        self.varint(bytes.len() as u64);
        self.0.extend_from_slice(bytes);
        self
    }

    /// Adds a message.
    pub(super) fn message(self, field: u64, message: &ProtobufMessage) -> Self {
        self.bytes(field, &message.0)
    }

    /// Adds messages as a repeated field.
    pub(super) fn messages(self, field: u64, messages: &[ProtobufMessage]) -> Self {
        messages.iter().fold(self, |all, message| all.message(field, message))
    }

    /// The bytes of the message.
    pub(super) fn into_bytes(self) -> Vec<u8> {
        self.0
    }

    fn varint(&mut self, mut value: u64) {
        while value >= 0x80 {
            self.0.push(value as u8 | 0x80);
            value >>= 7;
        }
        self.0.push(value as u8);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn messages_are_those_of_the_specification() {
        // The examples of "Encoding": a = 150 in field 1, "testing" in field 2, and a message in field 3.
        let number = ProtobufMessage::default().number(1, 150);
        assert_eq!(number.clone().into_bytes(), [0x08, 0x96, 0x01]);
        let text = ProtobufMessage::default().bytes(2, "testing");
        assert_eq!(text.into_bytes(), b"\x12\x07testing");
        let nested = ProtobufMessage::default().message(3, &number);
        assert_eq!(nested.into_bytes(), [0x1a, 0x03, 0x08, 0x96, 0x01]);
    }
}
