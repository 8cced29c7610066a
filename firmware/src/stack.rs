//! How deep the stack has been: cortex-m-rt paints it before the program starts.

use cortex_m_rt::STACK_PAINT_VALUE;

unsafe extern "C" {
    static _stack_end: u32;
    static _stack_start: u32;
}

/// Lowest address of the stack, and the one above its highest.
fn bounds() -> (*const u32, *const u32) {
    (&raw const _stack_end, &raw const _stack_start)
}

/// Lowest address of the stack.
#[must_use]
pub fn end() -> u32 {
    bounds().0 as u32
}

/// The word at an address of the stack, if it is one.
#[must_use]
pub fn word(address: u32) -> Option<u32> {
    let (low, high) = bounds();
    let place = core::ptr::with_exposed_provenance::<u32>(address as usize);
    // SAFETY: it is aligned and lies in the stack region, which is always readable.
    (place.is_aligned() && (low..high).contains(&place)).then(|| unsafe { place.read_volatile() })
}

/// Bytes of the stack that have been used since the start.
#[must_use]
pub fn high_water() -> usize {
    let (low, high) = bounds();
    let mut at = low;
    // SAFETY: `at` is aligned and lies in the stack region, which is always readable.
    while at < high && unsafe { at.read_volatile() } == STACK_PAINT_VALUE {
        at = at.wrapping_add(1);
    }
    high as usize - at as usize
}

/// Size of the stack region in bytes.
#[must_use]
pub fn size() -> usize {
    let (low, high) = bounds();
    high as usize - low as usize
}
