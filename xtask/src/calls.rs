//! The call graph of a linked image, from its machine code.

use std::collections::{BTreeMap, BTreeSet};
use std::fs;
use std::path::Path;

use object::read::elf::ElfFile32;
use object::{Object, ObjectSection, ObjectSymbol, SymbolKind};

use crate::error::Error;

/// Stack that a function is taken to need if the compiler does not say: assembly of the runtime.
const UNKNOWN_FRAME: u64 = 64;

/// Frames of assembly that comes without: of `salty` 0.3, by its first two instructions.
const ASSEMBLY_FRAMES: [(&str, u64); 3] = [
    ("fe25519_add_asm", 16),
    ("fe25519_mul_asm", 84),
    ("fe25519_square_asm", 64),
];

/// One function.
#[derive(Clone, Debug, Default)]
pub(crate) struct Function {
    pub(crate) name: String,
    end: u32,
    /// Bytes of its own frame.
    frame: Option<u64>,
    /// Functions that it calls or jumps to, and those whose address it loads: the compiler calls through a register
    /// what it calls several times.
    callees: BTreeSet<u32>,
    /// It calls through a register, and loads the address of no function.
    indirect: bool,
}

/// Functions by address.
#[derive(Clone, Debug, Default)]
pub(crate) struct CallGraph {
    functions: BTreeMap<u32, Function>,
}

/// The deepest chain of calls below a function.
#[derive(Clone, Debug, Default)]
pub(crate) struct Depth {
    pub(crate) bytes: u64,
    /// Functions of the chain, outermost first, with their frames.
    pub(crate) chain: Vec<(String, u64)>,
    /// Functions below whose frame is not known.
    pub(crate) unknown: BTreeSet<String>,
    /// Functions below that call through a register: the depth does not hold what they call.
    pub(crate) indirect: BTreeSet<String>,
    /// Functions below that can call themselves.
    pub(crate) recursive: BTreeSet<String>,
}

impl CallGraph {
    /// Reads an image; frames are known if it was compiled with stack sizes.
    pub(crate) fn read(path: &Path) -> Result<Self, Error> {
        let bytes = fs::read(path).map_err(|cause| Error::File {
            path: path.to_owned(),
            cause,
        })?;
        let broken = |what: String| Error::Image {
            path: path.to_owned(),
            what,
        };
        let file = ElfFile32::<object::LittleEndian>::parse(&*bytes)
            .map_err(|error| broken(error.to_string()))?;
        let section = |name: &str| {
            let section = file
                .section_by_name(name)
                .ok_or_else(|| broken(format!("it has no section {name}")))?;
            let data = section.data().map_err(|error| broken(error.to_string()))?;
            Ok::<_, Error>((section.address() as u32, data.to_vec()))
        };
        let mut graph = Self::default();
        let mut marks = BTreeMap::new();
        for symbol in file.symbols() {
            let name = symbol.name().unwrap_or_default();
            let address = symbol.address() as u32;
            // Mapping symbols tell code from the constants between it.
            if name.starts_with("$t") || name.starts_with("$d") {
                marks.insert(address, name.starts_with("$t"));
            } else if symbol.kind() == SymbolKind::Text && symbol.is_definition() {
                let start = address & !1;
                let function = graph.functions.entry(start).or_default();
                function.name = name.to_owned();
                function.end = function.end.max(start + symbol.size().max(2) as u32);
            }
        }
        let sizes = section(".stack_sizes").map_or_else(|_| Vec::new(), |(_, data)| data);
        for (address, size) in stack_sizes(&sizes) {
            if let Some(function) = graph.functions.get_mut(&(address & !1)) {
                function.frame = Some(size);
            }
        }
        for function in graph.functions.values_mut() {
            let assembly = |(name, _): &&(&str, u64)| *name == function.name;
            let noted = ASSEMBLY_FRAMES.iter().find(assembly);
            function.frame = function.frame.or(noted.map(|(_, frame)| *frame));
        }
        let (start, code) = section(".text")?;
        graph.add_calls(start, &code, &marks);
        Ok(graph)
    }

    fn add_calls(&mut self, start: u32, code: &[u8], marks: &BTreeMap<u32, bool>) {
        let half = |address: u32| {
            let at = (address - start) as usize;
            let pair = code.get(at..at + 2)?;
            Some(u16::from_le_bytes([pair[0], pair[1]]))
        };
        let starts: Vec<u32> = self.functions.keys().copied().collect();
        let containing = |address: u32| {
            let at = starts.partition_point(|start| *start <= address);
            at.checked_sub(1).map(|at| starts[at])
        };
        for (entry, function) in &mut self.functions {
            let mut at = *entry;
            let mut loads = Loads::default();
            let mut loaded = BTreeSet::new();
            while at < function.end && at >= start {
                let is_code = marks.range(..=at).next_back().is_none_or(|(_, code)| *code);
                let Some(first) = half(at).filter(|_| is_code) else {
                    at += 2;
                    continue;
                };
                let second = half(at + 2).unwrap_or(0);
                let wide = first >> 11 >= 0b11101;
                let value = loads.follow(at, first, second, |literal| {
                    let low = half(literal).filter(|_| literal >= start)?;
                    Some(u32::from(half(literal + 2)?) << 16 | u32::from(low))
                });
                // The address of a function has the Thumb bit.
                loaded.extend(
                    value
                        .filter(|value| {
                            value & 1 == 1 && starts.binary_search(&(value & !1)).is_ok()
                        })
                        .map(|value| value & !1),
                );
                match decode(at, first, second) {
                    Some(Branch::To(target)) if !(*entry..function.end).contains(&target) => {
                        function.callees.extend(containing(target));
                    }
                    Some(Branch::Register) => function.indirect = true,
                    _ => {}
                }
                at += if wide { 4 } else { 2 };
            }
            function.indirect &= loaded.is_empty();
            function.callees.extend(loaded);
        }
    }

    /// Functions that call one whose demangled name starts like this, and are not such themselves.
    pub(crate) fn callers(&self, start: &str) -> BTreeSet<String> {
        let name = |function: &Function| format!("{:#}", rustc_demangle::demangle(&function.name));
        let wanted = |entry: &u32| {
            self.functions
                .get(entry)
                .is_some_and(|function| name(function).starts_with(start))
        };
        self.functions
            .iter()
            .filter(|(entry, function)| !wanted(entry) && function.callees.iter().any(wanted))
            .map(|(_, function)| name(function))
            .collect()
    }

    /// The deepest chain below the function with this name.
    pub(crate) fn depth(&self, name: &str) -> Option<Depth> {
        let (entry, _) = self
            .functions
            .iter()
            .find(|(_, function)| function.name == name)?;
        let mut known = BTreeMap::new();
        Some(self.below(*entry, &mut Vec::new(), &mut known))
    }

    fn below(&self, entry: u32, path: &mut Vec<u32>, known: &mut BTreeMap<u32, Depth>) -> Depth {
        let Some(function) = self.functions.get(&entry) else {
            return Depth::default();
        };
        if path.contains(&entry) {
            return Depth {
                recursive: BTreeSet::from([function.name.clone()]),
                ..Depth::default()
            };
        }
        if let Some(depth) = known.get(&entry) {
            return depth.clone();
        }
        path.push(entry);
        let mut depth = Depth::default();
        for callee in &function.callees {
            let below = self.below(*callee, path, known);
            depth.unknown.extend(below.unknown);
            depth.indirect.extend(below.indirect);
            depth.recursive.extend(below.recursive);
            if below.bytes > depth.bytes {
                depth.bytes = below.bytes;
                depth.chain = below.chain;
            }
        }
        path.pop();
        let frame = function.frame.unwrap_or(UNKNOWN_FRAME);
        if function.frame.is_none() {
            depth.unknown.insert(function.name.clone());
        }
        if function.indirect {
            depth.indirect.insert(function.name.clone());
        }
        depth.bytes += frame;
        depth.chain.insert(0, (function.name.clone(), frame));
        known.insert(entry, depth.clone());
        depth
    }
}

/// Pairs of an address and a size in LEB128, as `-Zemit-stack-sizes` makes them.
fn stack_sizes(mut bytes: &[u8]) -> Vec<(u32, u64)> {
    let mut found = Vec::new();
    while let Some((address, rest)) = bytes.split_first_chunk::<4>() {
        let (mut size, mut shift, mut used) = (0, 0, 0);
        for byte in rest {
            size |= u64::from(byte & 0x7F) << shift;
            shift += 7;
            used += 1;
            if byte & 0x80 == 0 {
                break;
            }
        }
        found.push((u32::from_le_bytes(*address), size));
        bytes = &rest[used..];
    }
    found
}

/// Constants that a function loads into registers, in the order of its instructions.
#[derive(Debug, Default)]
struct Loads {
    /// Lower halves by register.
    low: [u32; 16],
}

impl Loads {
    /// The 32-bit constant that this instruction completes (ARMv7-M Architecture Reference Manual, A7.7.43, A7.7.76,
    /// A7.7.79). `literal` reads a word that stands in the code.
    fn follow(
        &mut self,
        at: u32,
        first: u16,
        second: u16,
        literal: impl Fn(u32) -> Option<u32>,
    ) -> Option<u32> {
        let (one, two) = (u32::from(first), u32::from(second));
        let base = (at + 4) & !3;
        let half = (one & 0xF) << 12 | (one >> 10 & 1) << 11 | (two >> 12 & 7) << 8 | two & 0xFF;
        let low = &mut self.low[(two >> 8 & 0xF) as usize];
        match one {
            // LDR Rt, [PC, #]: short, forwards and backwards.
            _ if one & 0xF800 == 0x4800 => literal(base + (one & 0xFF) * 4),
            0xF8DF => literal(base + (two & 0xFFF)),
            0xF85F => literal(base - (two & 0xFFF)),
            // MOVW, then MOVT.
            _ if one & 0xFBF0 == 0xF240 && two & 0x8000 == 0 => {
                *low = half;
                None
            }
            _ if one & 0xFBF0 == 0xF2C0 && two & 0x8000 == 0 => Some(half << 16 | *low),
            _ => None,
        }
    }
}

/// Where an instruction may go, apart from the next one.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Branch {
    To(u32),
    Register,
}

/// Sign-extends the lowest `bits` bits.
fn signed(value: u32, bits: u32) -> i32 {
    ((value << (32 - bits)) as i32) >> (32 - bits)
}

/// Decodes the branches of Thumb-2 (ARMv7-M Architecture Reference Manual, A7.7.12, A7.7.18, A7.7.19);
/// returns are none.
fn decode(at: u32, first: u16, second: u16) -> Option<Branch> {
    let (one, two) = (u32::from(first), u32::from(second));
    let to = |offset: i32| Some(Branch::To(at.wrapping_add(4).wrapping_add(offset as u32)));
    if one >> 11 == 0b11110 && two & 0x8000 != 0 {
        let sign = (one >> 10) & 1;
        let (j1, j2) = ((two >> 13) & 1, (two >> 11) & 1);
        let low = (two & 0x7FF) << 1;
        return match two & 0xD000 {
            // BL and B.W.
            0xD000 | 0x9000 => {
                let (i1, i2) = (1 ^ j1 ^ sign, 1 ^ j2 ^ sign);
                let offset = sign << 24 | i1 << 23 | i2 << 22 | (one & 0x3FF) << 12 | low;
                to(signed(offset, 25))
            }
            // B<c>.W; conditions 14 and 15 are other instructions.
            0x8000 if (one >> 6) & 0xF < 14 => {
                let offset = sign << 20 | j2 << 19 | j1 << 18 | (one & 0x3F) << 12 | low;
                to(signed(offset, 21))
            }
            _ => None,
        };
    }
    match one {
        _ if one & 0xF800 == 0xE000 => to(signed((one & 0x7FF) << 1, 12)),
        _ if one & 0xF000 == 0xD000 && (one >> 8) & 0xF < 14 => to(signed((one & 0xFF) << 1, 9)),
        // BX LR returns; BLX and BX of anything else go somewhere unknown.
        0x4770 => None,
        _ if one & 0xFF07 == 0x4700 => Some(Branch::Register),
        _ => None,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn branches_are_decoded_as_the_assembler_made_them() {
        // Assembled with arm-none-eabi-as at address 0x100.
        let table = [
            ((0xF000, 0xF8FE), Some(Branch::To(0x300))), // bl 0x300
            ((0xF7FF, 0xFF7E), Some(Branch::To(0x0))),   // bl 0x0
            ((0xF000, 0xB8FE), Some(Branch::To(0x300))), // b.w 0x300
            ((0xF000, 0x80FE), Some(Branch::To(0x300))), // beq.w 0x300
            ((0xE7FE, 0), Some(Branch::To(0x100))),      // b 0x100
            ((0xD0FE, 0), Some(Branch::To(0x100))),      // beq 0x100
            ((0x4798, 0), Some(Branch::Register)),       // blx r3
            ((0x4770, 0), None),                         // bx lr
            ((0xBF00, 0), None),                         // nop
            ((0xF3BF, 0x8F4F), None),                    // dsb
        ];
        for ((first, second), expected) in table {
            assert_eq!(
                decode(0x100, first, second),
                expected,
                "{first:#x} {second:#x}"
            );
        }
    }

    #[test]
    fn loaded_constants_are_followed_as_the_assembler_made_them() {
        // Assembled with arm-none-eabi-as at address 0x102.
        let table = [
            ((0x4D02, 0), Some(0x10C)),            // ldr r5, [pc, #8]
            ((0xF8DF, 0x8008), Some(0x10C)),       // ldr.w r8, [pc, #8]
            ((0xF85F, 0x8004), Some(0x100)),       // ldr.w r8, [pc, #-4]
            ((0xF240, 0x2501), None),              // movw r5, #0x201
            ((0xF6C0, 0x0502), Some(0x0802_0201)), // movt r5, #0x802
            ((0x47A8, 0), None),                   // blx r5
        ];
        let mut loads = Loads::default();
        for ((first, second), expected) in table {
            assert_eq!(
                loads.follow(0x102, first, second, Some),
                expected,
                "{first:#x} {second:#x}"
            );
        }
    }

    #[test]
    fn stack_sizes_are_read_with_sizes_of_one_and_two_bytes() {
        let bytes = [1, 0, 2, 8, 16, 5, 0, 2, 8, 0x80, 0x02];
        assert_eq!(stack_sizes(&bytes), [(0x0802_0001, 16), (0x0802_0005, 256)]);
    }
}
