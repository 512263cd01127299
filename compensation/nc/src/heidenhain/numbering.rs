//! The numbers of blocks, which stay consecutive.

use std::ops::Range;

/// Larger numbers of blocks are refused.
const MOST_NUMBER: u64 = 1_000_000_000;

/// The number with which a line begins, and where it stands; none above [`MOST_NUMBER`].
pub(crate) fn block_number(text: &[u8]) -> Option<(Range<usize>, u64)> {
    let from = text.iter().position(|byte| !matches!(byte, b' ' | b'\t'))?;
    let digits = text[from..].iter().take_while(|byte| byte.is_ascii_digit());
    let place = from..from + digits.count();
    let number = std::str::from_utf8(&text[place.clone()]).ok()?;
    let number = number
        .parse()
        .ok()
        .filter(|number| *number <= MOST_NUMBER)?;
    Some((place, number))
}

/// Gives the lines behind `begins` the next numbers from `number` on: the number of the line of the program, which stands at `at`,
/// becomes another one, and added lines get one.
pub(crate) fn renumber(out: &mut Vec<u8>, begins: usize, at: usize, number: u64) {
    let lines = out.split_off(begins);
    let lines = lines.split_inclusive(|byte| *byte == b'\n');
    for (line, number) in lines.zip(number..) {
        match block_number(line) {
            Some((place, _)) if place.start == at => {
                let width = match line[place.start] {
                    b'0' => place.len(),
                    _ => 0,
                };
                out.extend_from_slice(&line[..place.start]);
                out.extend_from_slice(format!("{number:0width$}").as_bytes());
                out.extend_from_slice(&line[place.end..]);
            }
            _ => {
                out.extend_from_slice(format!("{number} ").as_bytes());
                out.extend_from_slice(line);
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::renumber;

    #[test]
    fn added_lines_get_the_next_numbers() {
        let mut out = b"kept\nCC X+1 Y+2\r\n 007 C X+1\r\nL X+2".to_vec();
        renumber(&mut out, 5, 1, 12);
        assert_eq!(
            String::from_utf8_lossy(&out),
            "kept\n12 CC X+1 Y+2\r\n 013 C X+1\r\n14 L X+2"
        );
    }
}
