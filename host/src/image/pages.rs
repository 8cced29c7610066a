//! The pages of the update protocol in the host's memory.

use std::collections::BTreeMap;
use std::convert::Infallible;

use windlass_core::boot::image::{LAST_PAGE, PAGE_SIZE, Page, ReadPages};

/// Pages by number, 0 to [`LAST_PAGE`]; those that are missing are erased flash.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Pages(BTreeMap<u8, Box<Page>>);

impl Pages {
    /// Puts bytes at an offset of the page; what was never put reads as erased flash (0xFF). False if
    /// there is no such page, or the bytes run over its end.
    #[must_use]
    pub fn put(&mut self, page: u8, offset: usize, bytes: &[u8]) -> bool {
        if page > LAST_PAGE || offset.saturating_add(bytes.len()) > PAGE_SIZE {
            return false;
        }
        let target = self
            .0
            .entry(page)
            .or_insert_with(|| Box::new([0xFF; PAGE_SIZE]));
        target[offset..offset + bytes.len()].copy_from_slice(bytes);
        true
    }

    /// The page's contents; none if it does not belong to the image.
    #[must_use]
    pub fn get(&self, page: u8) -> Option<&Page> {
        self.0.get(&page).map(|page| &**page)
    }

    /// Every page with its number, ascending.
    pub fn iter(&self) -> impl DoubleEndedIterator<Item = (u8, &Page)> {
        self.0.iter().map(|(number, page)| (*number, &**page))
    }

    /// Number of pages.
    #[must_use]
    pub fn len(&self) -> usize {
        self.0.len()
    }

    /// True without any page.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.0.is_empty()
    }

    /// One bit for each page that is there.
    #[must_use]
    pub fn bitmap(&self) -> u32 {
        self.0.keys().fold(0, |bits, page| bits | 1 << page)
    }

    /// Leaves out a page.
    pub fn remove(&mut self, page: u8) {
        self.0.remove(&page);
    }
}

/// Missing pages read as erased flash.
impl ReadPages for &Pages {
    type Error = Infallible;

    fn read(&mut self, page: u8, offset: usize, bytes: &mut [u8]) -> Result<(), Infallible> {
        bytes.fill(0xFF);
        let found = self.get(page).and_then(|page| page.get(offset..));
        for (to, from) in bytes.iter_mut().zip(found.unwrap_or_default()) {
            *to = *from;
        }
        Ok(())
    }
}
