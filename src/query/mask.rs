//! Which points of a block: one bit each.

/// A set of points of one block.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub(crate) struct Mask {
    words: Vec<u64>,
    len: usize,
}

impl Mask {
    /// No point of `len`.
    pub fn none(len: usize) -> Self {
        Self { words: vec![0; len.div_ceil(64)], len }
    }

    /// All points of `len`.
    pub fn all(len: usize) -> Self {
        let mut mask = Self { words: vec![u64::MAX; len.div_ceil(64)], len };
        mask.trim();
        mask
    }

    /// The points whose value passes `test`.
    #[inline]
    pub fn where_each<T: Copy>(values: &[T], test: impl Fn(T) -> bool) -> Self {
        let word = |chunk: &[T]| chunk.iter().enumerate().fold(0, |w, (i, &v)| w | u64::from(test(v)) << i);
        Self { words: values.chunks(64).map(word).collect(), len: values.len() }
    }

    /// The points whose index passes `test`.
    #[inline]
    pub fn where_index(len: usize, test: impl Fn(usize) -> bool) -> Self {
        let word = |w: usize| (w * 64..len.min(w * 64 + 64)).fold(0, |bits, i| bits | u64::from(test(i)) << (i % 64));
        Self { words: (0..len.div_ceil(64)).map(word).collect(), len }
    }

    /// The points with these indices.
    pub fn of_indices(len: usize, indices: impl Iterator<Item = usize>) -> Self {
        let mut mask = Self::none(len);
        indices.for_each(|i| mask.words[i / 64] |= 1 << (i % 64));
        mask
    }

    fn trim(&mut self) {
        if let (Some(last), rest @ 1..) = (self.words.last_mut(), self.len % 64) {
            *last &= (1 << rest) - 1;
        }
    }

    /// Keeps what is in both.
    pub fn and(&mut self, other: &Self) {
        self.words.iter_mut().zip(&other.words).for_each(|(a, b)| *a &= b);
    }

    /// Takes in what is in `other`.
    pub fn or(&mut self, other: &Self) {
        self.words.iter_mut().zip(&other.words).for_each(|(a, b)| *a |= b);
    }

    /// Removes what is in `other`.
    pub fn and_not(&mut self, other: &Self) {
        self.words.iter_mut().zip(&other.words).for_each(|(a, b)| *a &= !b);
    }

    /// The number of points of the block.
    pub fn len(&self) -> usize {
        self.len
    }

    /// The number of points in the set.
    pub fn count(&self) -> usize {
        self.words.iter().map(|w| w.count_ones() as usize).sum()
    }

    /// Is no point in the set?
    pub fn is_none(&self) -> bool {
        self.words.iter().all(|&w| w == 0)
    }

    /// Is every point in the set?
    pub fn is_all(&self) -> bool {
        self.count() == self.len
    }

    /// Is point `i` in the set?
    #[inline]
    pub fn contains(&self, i: usize) -> bool {
        self.words[i / 64] >> (i % 64) & 1 == 1
    }

    /// Which of the points `64 * word` to `64 * word + 63` are in the set, from 0, ascending.
    pub fn indices_of_word(&self, word: usize) -> impl Iterator<Item = usize> + use<> {
        let mut rest = self.words.get(word).copied().unwrap_or(0);
        std::iter::from_fn(move || {
            let next = (rest != 0).then(|| rest.trailing_zeros() as usize);
            rest &= rest.wrapping_sub(1);
            next
        })
    }

    /// The points of the set, ascending.
    pub fn indices(&self) -> Vec<u32> {
        let mut indices = Vec::with_capacity(self.count());
        for (w, &word) in self.words.iter().enumerate() {
            let mut rest = word;
            while rest != 0 {
                indices.push((w * 64) as u32 + rest.trailing_zeros());
                rest &= rest - 1;
            }
        }
        indices
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn masks_are_sets(a in prop::collection::vec(any::<bool>(), 0..200), seed in any::<u64>()) {
            let b: Vec<bool> = (0..a.len()).map(|i| seed.rotate_left(i as u32) & 1 == 1).collect();
            let mask = Mask::where_each(&a, |v| v);
            prop_assert_eq!(&mask, &Mask::where_index(a.len(), |i| a[i]));
            let other = Mask::where_each(&b, |v| v);
            let naive = |f: &dyn Fn(bool, bool) -> bool| -> Vec<u32> {
                (0..a.len()).filter(|&i| f(a[i], b[i])).map(|i| i as u32).collect()
            };
            let applied = |f: &dyn Fn(&mut Mask)| { let mut m = mask.clone(); f(&mut m); m.indices() };
            prop_assert_eq!(applied(&|m| m.and(&other)), naive(&|x, y| x && y));
            prop_assert_eq!(applied(&|m| m.or(&other)), naive(&|x, y| x || y));
            prop_assert_eq!(applied(&|m| m.and_not(&other)), naive(&|x, y| x && !y));
            prop_assert_eq!(mask.count(), mask.indices().len());
            let of_words = (0..5).flat_map(|word| mask.indices_of_word(word).map(move |i| (word * 64 + i) as u32));
            prop_assert_eq!(of_words.collect::<Vec<_>>(), mask.indices());
            prop_assert_eq!(mask.is_none(), !a.contains(&true));
            prop_assert_eq!(mask.is_all(), !a.contains(&false));
            prop_assert_eq!(Mask::all(a.len()).count(), a.len());
            prop_assert!(Mask::none(a.len()).is_none());
            let again = Mask::of_indices(a.len(), mask.indices().into_iter().map(|i| i as usize));
            prop_assert_eq!(&again, &mask);
            prop_assert!((0..a.len()).all(|i| mask.contains(i) == a[i]));
        }
    }
}
