/* QEMU plugin (API version 1) that counts the instructions of watched functions, callees included.
 *
 * Arguments: watch=NAME:ADDRESS (any number of them), out=FILE.
 * A call begins with the first instruction of a watched function and ends when the instruction after
 * the one that called it is reached. One line a function: name, calls, least, mean, most, and which
 * call (from 1) took the most.
 *
 * The declarations below stand here because distributions do not ship qemu-plugin.h; they are those of
 * docs/devel/tcg-plugins.rst. */
#include <inttypes.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

typedef uint64_t qemu_plugin_id_t;
struct qemu_info_t;
struct qemu_plugin_tb;
struct qemu_plugin_insn;
enum qemu_plugin_cb_flags { QEMU_PLUGIN_CB_NO_REGS, QEMU_PLUGIN_CB_R_REGS, QEMU_PLUGIN_CB_RW_REGS };
typedef void (*translated_callback)(qemu_plugin_id_t, struct qemu_plugin_tb *);
typedef void (*executed_callback)(unsigned int, void *);
typedef void (*exit_callback)(qemu_plugin_id_t, void *);

void qemu_plugin_register_vcpu_tb_trans_cb(qemu_plugin_id_t, translated_callback);
void qemu_plugin_register_vcpu_insn_exec_cb(struct qemu_plugin_insn *, executed_callback,
                                            enum qemu_plugin_cb_flags, void *);
void qemu_plugin_register_atexit_cb(qemu_plugin_id_t, exit_callback, void *);
size_t qemu_plugin_tb_n_insns(const struct qemu_plugin_tb *);
struct qemu_plugin_insn *qemu_plugin_tb_get_insn(const struct qemu_plugin_tb *, size_t);
uint64_t qemu_plugin_insn_vaddr(const struct qemu_plugin_insn *);
size_t qemu_plugin_insn_size(const struct qemu_plugin_insn *);

#define EXPORT __attribute__((visibility("default")))
EXPORT int qemu_plugin_version = 1;

#define WATCHES 32
#define DEPTH 16

struct watch {
    char name[48];
    uint32_t address;
    uint64_t calls, sum, least, most, most_at;
};

struct call {
    struct watch *watch;
    uint32_t back;
    uint64_t started;
};

static struct watch watches[WATCHES];
static size_t watch_count;
static struct call stack[DEPTH];
static size_t depth;
static uint64_t executed;
/* Address of the instruction after the one executed last. */
static uint32_t following;
static FILE *out;

static void end_call(void)
{
    struct call *call = &stack[--depth];
    struct watch *watch = call->watch;
    uint64_t count = executed - call->started;

    watch->calls++;
    watch->sum += count;
    if (count < watch->least)
        watch->least = count;
    if (count > watch->most) {
        watch->most = count;
        watch->most_at = watch->calls;
    }
}

/* The argument carries the address in its upper and the size in its lower half. */
static void on_instruction(unsigned int cpu, void *argument)
{
    uint64_t packed = (uint64_t)(uintptr_t)argument;
    uint32_t address = (uint32_t)(packed >> 8);
    (void)cpu;

    while (depth > 0 && stack[depth - 1].back == address)
        end_call();
    for (size_t at = 0; at < watch_count; at++) {
        if (watches[at].address == address && depth < DEPTH)
            stack[depth++] = (struct call){&watches[at], following, executed};
    }
    executed++;
    following = address + (uint32_t)(packed & 0xff);
}

static void on_translated(qemu_plugin_id_t id, struct qemu_plugin_tb *block)
{
    (void)id;
    for (size_t at = 0; at < qemu_plugin_tb_n_insns(block); at++) {
        struct qemu_plugin_insn *instruction = qemu_plugin_tb_get_insn(block, at);
        uint64_t packed = qemu_plugin_insn_vaddr(instruction) << 8 |
                          qemu_plugin_insn_size(instruction);

        qemu_plugin_register_vcpu_insn_exec_cb(instruction, on_instruction, QEMU_PLUGIN_CB_NO_REGS,
                                               (void *)(uintptr_t)packed);
    }
}

static void report(qemu_plugin_id_t id, void *unused)
{
    (void)id;
    (void)unused;
    for (size_t at = 0; at < watch_count; at++) {
        struct watch *watch = &watches[at];
        double mean = watch->calls ? (double)watch->sum / (double)watch->calls : 0.0;

        fprintf(out, "%s %" PRIu64 " %" PRIu64 " %.2f %" PRIu64 " %" PRIu64 "\n", watch->name,
                watch->calls, watch->calls ? watch->least : 0, mean, watch->most, watch->most_at);
    }
    fclose(out);
}

static int add_watch(const char *text)
{
    const char *colon = strrchr(text, ':');

    if (watch_count == WATCHES || !colon || (size_t)(colon - text) >= sizeof watches[0].name)
        return -1;
    struct watch *watch = &watches[watch_count++];
    memcpy(watch->name, text, (size_t)(colon - text));
    watch->address = (uint32_t)strtoul(colon + 1, NULL, 0) & ~1u;
    watch->least = UINT64_MAX;
    return 0;
}

EXPORT int qemu_plugin_install(qemu_plugin_id_t id, const struct qemu_info_t *info, int count,
                               char **arguments)
{
    (void)info;
    for (int at = 0; at < count; at++) {
        if (strncmp(arguments[at], "watch=", 6) == 0) {
            if (add_watch(arguments[at] + 6) != 0)
                return -1;
        } else if (strncmp(arguments[at], "out=", 4) == 0) {
            out = fopen(arguments[at] + 4, "w");
        }
    }
    if (!out)
        return -1;
    qemu_plugin_register_vcpu_tb_trans_cb(id, on_translated);
    qemu_plugin_register_atexit_cb(id, report, NULL);
    return 0;
}
