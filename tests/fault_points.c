/* Ends or interrupts this process at the n-th change that it makes under a folder.
 *
 * A seccomp filter traps every system call that can change a file (so that no library, whatever it
 * links, goes past it); the handler counts those whose path or descriptor lies under the folder,
 * and carries out the others, and those before the n-th, unchanged. Linux on x86-64 and ARM64.
 *
 * gcc -shared -fPIC -O1 -o fault_points.so fault_points.c
 */
#define _GNU_SOURCE
#include <errno.h>
#include <fcntl.h>
#include <linux/audit.h>
#include <linux/filter.h>
#include <linux/seccomp.h>
#include <signal.h>
#include <stddef.h>
#include <stdint.h>
#include <string.h>
#include <sys/prctl.h>
#include <sys/syscall.h>
#include <ucontext.h>
#include <unistd.h>

#if defined(__x86_64__)
#define ARCHITECTURE AUDIT_ARCH_X86_64
#define ARGUMENTS(c) {(c)->gregs[REG_RDI], (c)->gregs[REG_RSI], (c)->gregs[REG_RDX], \
                      (c)->gregs[REG_R10], (c)->gregs[REG_R8]}
#define RESULT(c) ((c)->gregs[REG_RAX])
#elif defined(__aarch64__)
#define ARCHITECTURE AUDIT_ARCH_AARCH64
#define ARGUMENTS(c) {(c)->regs[0], (c)->regs[1], (c)->regs[2], (c)->regs[3], (c)->regs[4]}
#define RESULT(c) ((c)->regs[0])
#else
#error "the trapped calls of this processor are not known"
#endif

/* The sixth argument marks the calls that the handler makes itself: none of these takes six. */
#define OURS 0x5eedfa17u

enum kind { OPENS, DESCRIPTOR, PATH, PATH_AT, TWO_PATHS, TWO_PATHS_AT, LINKS, LINKS_AT };

static const struct { int number; enum kind kind; const char *name; } CALLS[] = {
#ifdef SYS_open
    {SYS_open, OPENS, "open"}, {SYS_creat, OPENS, "creat"}, {SYS_rename, TWO_PATHS, "rename"},
    {SYS_unlink, PATH, "unlink"}, {SYS_rmdir, PATH, "rmdir"}, {SYS_mkdir, PATH, "mkdir"},
    {SYS_link, TWO_PATHS, "link"}, {SYS_symlink, LINKS, "symlink"},
#endif
#ifdef SYS_renameat
    {SYS_renameat, TWO_PATHS_AT, "renameat"},
#endif
    {SYS_openat, OPENS, "openat"}, {SYS_renameat2, TWO_PATHS_AT, "renameat2"},
    {SYS_unlinkat, PATH_AT, "unlinkat"}, {SYS_mkdirat, PATH_AT, "mkdirat"},
    {SYS_linkat, TWO_PATHS_AT, "linkat"}, {SYS_symlinkat, LINKS_AT, "symlinkat"},
    {SYS_write, DESCRIPTOR, "write"}, {SYS_pwrite64, DESCRIPTOR, "pwrite"},
    {SYS_writev, DESCRIPTOR, "writev"}, {SYS_pwritev, DESCRIPTOR, "pwritev"},
    {SYS_pwritev2, DESCRIPTOR, "pwritev2"}, {SYS_ftruncate, DESCRIPTOR, "ftruncate"},
    {SYS_truncate, PATH, "truncate"}, {SYS_fallocate, DESCRIPTOR, "fallocate"},
    {SYS_fsync, DESCRIPTOR, "fsync"}, {SYS_fdatasync, DESCRIPTOR, "fdatasync"},
};
#define COUNT (sizeof CALLS / sizeof *CALLS)

static char folder[4096];
static size_t folder_length;
static long target, counted;
static int signal_number, log_descriptor = -1;

static long call(long number, const long *a)
{
#if defined(__x86_64__)
    long result;
    register long r10 __asm__("r10") = a[3];
    register long r8 __asm__("r8") = a[4];
    register long r9 __asm__("r9") = OURS;
    __asm__ volatile("syscall" : "=a"(result)
                     : "a"(number), "D"(a[0]), "S"(a[1]), "d"(a[2]), "r"(r10), "r"(r8), "r"(r9)
                     : "rcx", "r11", "memory");
    return result;
#else
    register long x8 __asm__("x8") = number;
    register long x0 __asm__("x0") = a[0];
    register long x1 __asm__("x1") = a[1];
    register long x2 __asm__("x2") = a[2];
    register long x3 __asm__("x3") = a[3];
    register long x4 __asm__("x4") = a[4];
    register long x5 __asm__("x5") = OURS;
    __asm__ volatile("svc 0" : "+r"(x0)
                     : "r"(x8), "r"(x1), "r"(x2), "r"(x3), "r"(x4), "r"(x5) : "memory");
    return x0;
#endif
}

static void append(char *text, size_t size, const char *more)
{
    size_t length = strlen(text);
    strncat(text, more, size - length - 1);
}

/* The path behind a descriptor, as the system writes it. */
static void path_of(int descriptor, char *path, size_t size)
{
    char link[64] = "/proc/self/cwd", digits[16];
    if (descriptor != AT_FDCWD) {
        char *at = digits + sizeof digits - 1;
        *at = 0;
        do *--at = '0' + descriptor % 10; while (descriptor /= 10);
        strcpy(link, "/proc/self/fd/");
        append(link, sizeof link, at);
    }
    long a[5] = {AT_FDCWD, (long)link, (long)path, (long)size - 1, 0};
    long length = call(SYS_readlinkat, a);
    path[length > 0 ? length : 0] = 0;
}

static void resolve(int directory, const char *given, char *path, size_t size)
{
    path[0] = 0;
    if (given[0] != '/') {
        path_of(directory, path, size);
        append(path, size, "/");
    }
    append(path, size, given);
}

static int inside(const char *path)
{
    return !strncmp(path, folder, folder_length) && (!path[folder_length] || path[folder_length] == '/');
}

/* Whether a call changes something under the folder; its path. */
static int matters(int number, enum kind kind, const long *a, char *path, size_t size)
{
    int at = kind == PATH_AT || kind == TWO_PATHS_AT || number == SYS_openat;
    switch (kind) {
    case OPENS: {
        long flags = number == SYS_openat ? a[2] : a[1];
#ifdef SYS_creat
        if (number == SYS_creat) flags = O_WRONLY;
#endif
        if ((flags & O_ACCMODE) == O_RDONLY && !(flags & (O_CREAT | O_TRUNC))) return 0;
        break;
    }
    case DESCRIPTOR:
        path_of((int)a[0], path, size);
        return inside(path);
    case LINKS:
        resolve(AT_FDCWD, (const char *)a[1], path, size);
        return inside(path);
    case LINKS_AT:
        resolve((int)a[1], (const char *)a[2], path, size);
        return inside(path);
    case TWO_PATHS: case TWO_PATHS_AT:
        resolve(at ? (int)a[2] : AT_FDCWD, (const char *)a[at ? 3 : 1], path, size);
        if (inside(path)) return 1;
        break;
    default:
        break;
    }
    resolve(at ? (int)a[0] : AT_FDCWD, (const char *)a[at ? 1 : 0], path, size);
    return inside(path);
}

static void note(const char *name, const char *path)
{
    char line[4200] = "";
    append(line, sizeof line, name);
    append(line, sizeof line, " ");
    append(line, sizeof line, path);
    append(line, sizeof line, "\n");
    long a[5] = {log_descriptor, (long)line, (long)strlen(line), 0, 0};
    call(SYS_write, a);
}

static void trapped(int number, siginfo_t *info, void *context)
{
    (void)number;
    mcontext_t *machine = &((ucontext_t *)context)->uc_mcontext;
    long a[5] = ARGUMENTS(machine);
    char path[4096];
    for (size_t i = 0; i < COUNT; i++) {
        if (CALLS[i].number != info->si_syscall) continue;
        if (!matters(CALLS[i].number, CALLS[i].kind, a, path, sizeof path)) break;
        if (log_descriptor >= 0) note(CALLS[i].name, path);
        if (__atomic_add_fetch(&counted, 1, __ATOMIC_SEQ_CST) != target) break;
        long self[5] = {getpid(), signal_number, 0, 0, 0};
        if (signal_number == SIGKILL && (info->si_syscall == SYS_write || info->si_syscall == SYS_pwrite64)) {
            a[2] /= 2; /* as torn as a write can be */
            call(info->si_syscall, a);
        }
        call(SYS_kill, self);
        break;
    }
    RESULT(machine) = call(info->si_syscall, a);
}

/* Start to count. At call `n` under `root` (0: never) the process gets signal `with`: before the
 * call is made, or, for SIGKILL in a write, after half of it. Calls are written to `log`, unless
 * it is -1. Returns 0, or an errno. */
int arm(const char *root, long n, int with, int log)
{
    struct sock_filter code[COUNT + 10];
    size_t at = 0, low = offsetof(struct seccomp_data, args[5]);
    strncpy(folder, root, sizeof folder - 1);
    folder_length = strlen(folder);
    target = n, signal_number = with, log_descriptor = log, counted = 0;
    struct sigaction action = {.sa_flags = SA_SIGINFO | SA_NODEFER};
    action.sa_sigaction = trapped;
    if (sigaction(SIGSYS, &action, NULL)) return errno;
#define ADD(...) code[at++] = (struct sock_filter)__VA_ARGS__
    ADD(BPF_STMT(BPF_LD | BPF_W | BPF_ABS, offsetof(struct seccomp_data, arch)));
    ADD(BPF_JUMP(BPF_JMP | BPF_JEQ | BPF_K, ARCHITECTURE, 1, 0));
    ADD(BPF_STMT(BPF_RET | BPF_K, SECCOMP_RET_ALLOW));
    ADD(BPF_STMT(BPF_LD | BPF_W | BPF_ABS, offsetof(struct seccomp_data, nr)));
    for (size_t i = 0; i < COUNT; i++)
        ADD(BPF_JUMP(BPF_JMP | BPF_JEQ | BPF_K, CALLS[i].number, COUNT - i, 0));
    ADD(BPF_STMT(BPF_RET | BPF_K, SECCOMP_RET_ALLOW));
    ADD(BPF_STMT(BPF_LD | BPF_W | BPF_ABS, low));
    ADD(BPF_JUMP(BPF_JMP | BPF_JEQ | BPF_K, OURS, 0, 1));
    ADD(BPF_STMT(BPF_RET | BPF_K, SECCOMP_RET_ALLOW));
    ADD(BPF_STMT(BPF_RET | BPF_K, SECCOMP_RET_TRAP));
    struct sock_fprog program = {.len = (unsigned short)at, .filter = code};
    if (prctl(PR_SET_NO_NEW_PRIVS, 1, 0, 0, 0)) return errno;
    if (prctl(PR_SET_SECCOMP, SECCOMP_MODE_FILTER, &program)) return errno;
    return 0;
}
