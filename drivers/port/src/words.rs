/// Maximum number of words of a block.
pub const MOST_WORDS: usize = 40;

/// A block of 16-bit words with fixed capacity, so that copying does not allocate. A comparison ignores the unused
/// capacity.
#[derive(Clone, Copy)]
pub struct Words {
    words: [u16; MOST_WORDS],
    length: usize,
}

impl Words {
    pub const EMPTY: Self = Self { words: [0; MOST_WORDS], length: 0 };

    /// Creates a block of these words; `None` if there are more than [`MOST_WORDS`].
    #[must_use]
    pub fn new(words: &[u16]) -> Option<Self> {
        let mut block = Self { words: [0; MOST_WORDS], length: words.len() };
        block.words.get_mut(..words.len())?.copy_from_slice(words);
        Some(block)
    }

    #[must_use]
    pub fn as_slice(&self) -> &[u16] {
        &self.words[..self.length]
    }

    pub fn as_mut_slice(&mut self) -> &mut [u16] {
        &mut self.words[..self.length]
    }
}

impl Default for Words {
    fn default() -> Self {
        Self::EMPTY
    }
}

impl PartialEq for Words {
    fn eq(&self, other: &Self) -> bool {
        self.as_slice() == other.as_slice()
    }
}

impl Eq for Words {}

impl core::fmt::Debug for Words {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        f.debug_list().entries(self.as_slice()).finish()
    }
}
