/* Lets user-mode Linux 6.1 set registers on a processor with AMX: gcc -shared -fPIC -O2, by LD_PRELOAD.
 *
 * UML saves a guest's registers by PTRACE_GETREGSET into a buffer for AVX-512. The host's set is larger with AMX, and
 * the host takes only a whole set back (EFAULT otherwise). A set that is too short is laid over the whole one.
 * Source: arch/x86/kernel/fpu/regset.c, arch/x86/um/os-Linux/registers.c of Linux 6.1. */
#define _GNU_SOURCE
#include <stdarg.h>
#include <string.h>
#include <sys/ptrace.h>
#include <sys/syscall.h>
#include <sys/uio.h>
#include <unistd.h>

#define NT_X86_XSTATE 0x202
static _Alignas(64) char whole[65536]; /* one thread of UML traces */

long ptrace(enum __ptrace_request request, ...)
{
    va_list words;
    va_start(words, request);
    long pid = va_arg(words, long);
    void *address = va_arg(words, void *), *data = va_arg(words, void *);
    va_end(words);
    if (request == PTRACE_SETREGSET && (long)address == NT_X86_XSTATE) {
        const struct iovec *given = data;
        struct iovec all = {whole, sizeof whole};
        if (!syscall(SYS_ptrace, PTRACE_GETREGSET, pid, address, &all) && all.iov_len > given->iov_len) {
            memcpy(whole, given->iov_base, given->iov_len);
            return syscall(SYS_ptrace, request, pid, address, &all);
        }
    }
    if (request == PTRACE_PEEKTEXT || request == PTRACE_PEEKDATA || request == PTRACE_PEEKUSER) {
        long value;
        return syscall(SYS_ptrace, request, pid, address, &value) ? -1 : value;
    }
    return syscall(SYS_ptrace, request, pid, address, data);
}
