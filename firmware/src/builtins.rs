//! The compiler's memory functions, small: those of its library are fast and take 700 bytes, and the bootloader copies
//! nothing that matters.
//!
//! Names and registers are those of the Run-time ABI for the Arm Architecture (4.3.4) and of C. The `__aeabi_`
//! forms give nothing back, so that one body serves both; `__aeabi_memset` has its last two arguments the other
//! way round.

use core::arch::global_asm;

global_asm!(
    ".syntax unified",
    ".section .text.memory, \"ax\"",
    ".macro function name, frame=0",
    ".global \\name",
    ".type \\name, %function",
    ".thumb_func",
    "\\name:",
    // What the compiler notes of its own functions: the bytes of the stack frame, for `cargo xtask stack`.
    ".pushsection .stack_sizes, \"o\", %progbits, .text.memory",
    ".4byte \\name",
    ".uleb128 \\frame",
    ".popsection",
    ".endm",
    // memcpy(r0 to, r1 from, r2 bytes)
    "function __aeabi_memcpy",
    "function __aeabi_memcpy4",
    "function __aeabi_memcpy8",
    "function memcpy",
    "mov r12, r0",
    "1: subs r2, #1",
    "bmi 2f",
    "ldrb r3, [r1], #1",
    "strb r3, [r12], #1",
    "b 1b",
    "2: bx lr",
    // memmove: downwards is always right if `to` lies above `from`, upwards otherwise.
    "function __aeabi_memmove",
    "function __aeabi_memmove4",
    "function __aeabi_memmove8",
    "function memmove",
    "cmp r0, r1",
    "bls memcpy",
    "3: subs r2, #1",
    "bmi 2b",
    "ldrb r3, [r1, r2]",
    "strb r3, [r0, r2]",
    "b 3b",
    // memclr(r0 to, r1 bytes), then memset(r0 to, r1 bytes, r2 value)
    "function __aeabi_memclr",
    "function __aeabi_memclr4",
    "function __aeabi_memclr8",
    "movs r2, #0",
    "function __aeabi_memset",
    "function __aeabi_memset4",
    "function __aeabi_memset8",
    "mov r3, r0",
    "4: subs r1, #1",
    "bmi 2b",
    "strb r2, [r3], #1",
    "b 4b",
    // memset(r0 to, r1 value, r2 bytes)
    "function memset",
    "mov r3, r1",
    "mov r1, r2",
    "mov r2, r3",
    "b __aeabi_memset",
    // memcmp(r0 one, r1 other, r2 bytes): the difference of the first two bytes that differ
    "function memcmp, 8",
    "function bcmp, 8",
    "push {{r4, lr}}",
    "mov r12, r0",
    "movs r0, #0",
    "5: subs r2, #1",
    "bmi 6f",
    "ldrb r3, [r12], #1",
    "ldrb r4, [r1], #1",
    "subs r0, r3, r4",
    "beq 5b",
    "6: pop {{r4, pc}}",
    ".purgem function",
);
