//! STATUSTEXT: what Holdover has to say to the pilot.
//!
//! A message holds 50 bytes. A longer text goes out in chunks that share an id; "any null character in the text field is
//! taken to mean this was the last chunk", so every chunk but the last must be full.

use mavlink::dialects::ardupilotmega::{MavMessage, MavSeverity, STATUSTEXT_DATA};
use mavlink::types::CharArray;

const CHUNK_LEN: usize = 50;

/// The longest text that is sent, in bytes; more is cut off. A telemetry radio has no room for an essay.
pub const MAX_TEXT_LEN: usize = 8 * CHUNK_LEN - 1;

/// Makes STATUSTEXT messages.
#[derive(Clone, Debug, Default)]
pub struct StatusTextWriter {
    last_id: u16,
}

impl StatusTextWriter {
    /// A writer whose first long text has id 1.
    pub fn new() -> Self {
        Self::default()
    }

    /// The messages for `text`, in order: one if it has no more than 50 bytes, else several. No character is torn in two: a
    /// chunk in which the next character finds no room is filled up with blanks. Control characters become blanks. An empty
    /// text gives no message.
    pub fn write(&mut self, severity: MavSeverity, text: &str) -> Vec<MavMessage> {
        let mut clean: String = text.chars().map(|c| if c.is_control() { ' ' } else { c }).collect();
        if clean.is_empty() {
            return Vec::new();
        }
        if clean.len() <= CHUNK_LEN {
            return vec![message(severity, clean.as_bytes(), 0, 0)];
        }
        clean.truncate(cut_before(&clean, MAX_TEXT_LEN));
        // Id 0 means a text of one chunk.
        self.last_id = self.last_id.checked_add(1).unwrap_or(1);
        let mut chunks = Vec::new();
        let mut rest = clean.as_str();
        let mut ended = false;
        while !ended {
            let (chunk, after) = rest.split_at(cut_before(rest, CHUNK_LEN));
            rest = after;
            // A full chunk says that more will come, so a text that fills its last chunk is ended by an empty one.
            ended = after.is_empty() && chunk.len() < CHUNK_LEN;
            let mut bytes = chunk.as_bytes().to_vec();
            if !ended {
                bytes.resize(CHUNK_LEN, b' ');
            }
            let seq = u8::try_from(chunks.len()).unwrap_or(u8::MAX);
            chunks.push(message(severity, &bytes, self.last_id, seq));
        }
        chunks
    }
}

fn message(severity: MavSeverity, bytes: &[u8], id: u16, chunk_seq: u8) -> MavMessage {
    let mut text = [0u8; CHUNK_LEN];
    for (to, from) in text.iter_mut().zip(bytes) {
        *to = *from;
    }
    MavMessage::STATUSTEXT(STATUSTEXT_DATA { severity, text: CharArray::new(text), id, chunk_seq })
}

/// The last place not after `index` where `text` may be cut.
fn cut_before(text: &str, index: usize) -> usize {
    (0..=index.min(text.len())).rev().find(|&i| text.is_char_boundary(i)).unwrap_or(0)
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn parts(messages: &[MavMessage]) -> Vec<STATUSTEXT_DATA> {
        messages
            .iter()
            .map(|m| match m {
                MavMessage::STATUSTEXT(data) => data.clone(),
                other => panic!("{other:?}"),
            })
            .collect()
    }

    /// Puts chunks together as a ground station does: up to the first chunk with a null character.
    fn assembled(parts: &[STATUSTEXT_DATA]) -> String {
        let mut text = String::new();
        for (i, part) in parts.iter().enumerate() {
            assert_eq!(usize::from(part.chunk_seq), i);
            let chunk = part.text.to_str().unwrap();
            text.push_str(chunk);
            assert_eq!(
                chunk.len() < CHUNK_LEN,
                i + 1 == parts.len(),
                "chunk {i} ends the text too early or not"
            );
        }
        text
    }

    #[test]
    fn a_short_text_is_one_message_with_id_0() {
        let mut writer = StatusTextWriter::new();
        for text in ["Holdover: GNSS lost", &"x".repeat(50)] {
            let parts = parts(&writer.write(MavSeverity::MAV_SEVERITY_WARNING, text));
            assert_eq!(parts.len(), 1);
            assert_eq!((parts[0].id, parts[0].chunk_seq), (0, 0));
            assert_eq!(parts[0].text.to_str().unwrap(), text);
        }
        assert!(writer.write(MavSeverity::MAV_SEVERITY_WARNING, "").is_empty());
    }

    #[test]
    fn a_long_text_comes_together_again_and_each_has_an_id_of_its_own() {
        let mut writer = StatusTextWriter::new();
        for (len, chunks) in [(51, 2), (99, 2), (100, 3), (120, 3)] {
            let text: String = ('a'..='z').cycle().take(len).collect();
            let parts = parts(&writer.write(MavSeverity::MAV_SEVERITY_INFO, &text));
            assert_eq!(parts.len(), chunks, "{len}");
            assert_eq!(assembled(&parts), text);
        }
        assert_eq!(writer.last_id, 4);
    }

    #[test]
    fn the_id_never_becomes_0_again() {
        let mut writer = StatusTextWriter { last_id: u16::MAX };
        assert_eq!(parts(&writer.write(MavSeverity::MAV_SEVERITY_INFO, &"x".repeat(60)))[0].id, 1);
    }

    proptest! {
        #[test]
        fn any_text_survives_but_for_blanks_and_its_tail(text in "\\PC{0,120}") {
            let parts = parts(&StatusTextWriter::new().write(MavSeverity::MAV_SEVERITY_INFO, &text));
            prop_assert!(parts.len() <= 9);
            if text.len() > CHUNK_LEN {
                let squeeze = |s: &str| s.replace(' ', "");
                let got = squeeze(&assembled(&parts));
                prop_assert!(squeeze(&text).starts_with(&got));
                if text.len() <= MAX_TEXT_LEN {
                    prop_assert_eq!(got, squeeze(&text));
                }
            }
        }
    }
}
