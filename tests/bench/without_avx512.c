// What the instruction CPUID says, without AVX-512, VNNI and AMX, for tests/bench/without_avx512.py: there CPUID (0F A2)
// is replaced by UD2 (0F 0B), equally long, whose signal is answered here. Preloaded, so that it is there before any
// library asks.
#define _GNU_SOURCE
#include <dlfcn.h>
#include <signal.h>
#include <stdint.h>
#include <string.h>
#include <ucontext.h>

#define BIT(n) (UINT32_C(1) << (n))

// Names and places of the features: Intel 64 and IA-32 Architectures Software Developer's Manual, volume 2A, CPUID.
static void hide(uint32_t leaf, uint32_t part, uint32_t *a, uint32_t *b, uint32_t *c, uint32_t *d) {
    if (leaf == 7 && part == 0) {
        *b &= ~(BIT(16) | BIT(17) | BIT(21) | BIT(26) | BIT(27) | BIT(28) | BIT(30) | BIT(31));  // F DQ IFMA PF ER CD BW VL
        *c &= ~(BIT(1) | BIT(6) | BIT(11) | BIT(12) | BIT(14));  // VBMI VBMI2 VNNI BITALG VPOPCNTDQ
        *d &= ~(BIT(2) | BIT(3) | BIT(8) | BIT(22) | BIT(23) | BIT(24) | BIT(25));  // 4VNNIW 4FMAPS VP2INTERSECT AMX FP16
    } else if (leaf == 7 && part == 1) {
        *a &= ~(BIT(4) | BIT(5) | BIT(21) | BIT(23));  // AVX-VNNI AVX512-BF16 AMX-FP16 AVX-IFMA
        *d &= ~(BIT(4) | BIT(5) | BIT(10) | BIT(19));  // AVX-VNNI-INT8, AVX-NE-CONVERT, AVX-VNNI-INT16, AVX10
    } else if (leaf == 0x24) {  // AVX10
        *a = *b = *c = *d = 0;
    }
}

typedef int change_action(int, const struct sigaction *, struct sigaction *);
static change_action *change;  // the C library's own sigaction

static void answer(int signal_number, siginfo_t *info, void *context) {
    (void)info;
    greg_t *registers = ((ucontext_t *)context)->uc_mcontext.gregs;
    const uint8_t *at = (const uint8_t *)registers[REG_RIP];
    if (at[0] != 0x0f || at[1] != 0x0b) {
        struct sigaction usual;  // somebody's own illegal instruction: it comes again
        memset(&usual, 0, sizeof usual);
        usual.sa_handler = SIG_DFL;
        change(signal_number, &usual, 0);
        return;
    }
    uint32_t leaf = (uint32_t)registers[REG_RAX], part = (uint32_t)registers[REG_RCX];
    uint32_t a = leaf, b = 0, c = part, d = 0;
    __asm__ volatile("cpuid" : "+a"(a), "=b"(b), "+c"(c), "=d"(d));
    hide(leaf, part, &a, &b, &c, &d);
    registers[REG_RAX] = a;
    registers[REG_RBX] = b;
    registers[REG_RCX] = c;
    registers[REG_RDX] = d;
    registers[REG_RIP] += 2;
}

__attribute__((constructor)) static void listen(void) {
    struct sigaction action;
    memset(&action, 0, sizeof action);
    action.sa_sigaction = answer;
    action.sa_flags = SA_SIGINFO | SA_NODEFER | SA_ONSTACK;
    change = (change_action *)dlsym(RTLD_NEXT, "sigaction");
    change(SIGILL, &action, 0);
}

// Libraries that report crashes (COLMAP's) would take the signal for themselves.
int sigaction(int signal_number, const struct sigaction *action, struct sigaction *before) {
    if (!change) change = (change_action *)dlsym(RTLD_NEXT, "sigaction");
    return change(signal_number, signal_number == SIGILL ? 0 : action, before);
}
