/* What the C library and the compiler's support library expect of the system under them.
 *
 * The kernels are linked without an operating system: memcpy, memset, memmove and errno are those of the
 * cross compiler's C library, mathematics those of its libm, software floating point that of libgcc. Nothing
 * else of the C library is linked: the few names that these ask for are here. Nothing here runs in a kernel,
 * but __aeabi_read_tp where libm sets errno. */
#include <stdint.h>

/* No vector floating point unit, no other extension: ARM926EJ-S as the paper's processor has it. */
uint32_t _dl_hwcap = 0;

/* libm was compiled with stack protection, the kernels are not. */
uint32_t __stack_chk_guard = 0x00ff0a0du;

void __stack_chk_fail(void);
void *__aeabi_read_tp(void);
int raise(int signal_number);
int _start(void);

/* An undefined instruction, which a simulator or a debugger reports with its address. */
static void stop(void)
{
    __asm__ volatile(".word 0xe7f000f0");
}

void __stack_chk_fail(void)
{
    stop();
}

/* A division of whole numbers by zero, from libgcc. */
int raise(int signal_number)
{
    (void)signal_number;
    stop();
    return 0;
}

/* The one thread's storage: eight bytes of the thread control block, then the thread's variables. */
static uint32_t thread_storage[8] __attribute__((aligned(8)));

void *__aeabi_read_tp(void)
{
    return thread_storage;
}

/* libm's functions carry unwinding tables that name these; nothing is ever unwound. */
void __aeabi_unwind_cpp_pr0(void);
void __aeabi_unwind_cpp_pr1(void);
void __aeabi_unwind_cpp_pr2(void);
void __aeabi_unwind_cpp_pr0(void) {}
void __aeabi_unwind_cpp_pr1(void) {}
void __aeabi_unwind_cpp_pr2(void) {}

/* The kernels are called one by one by their names; the program as such does nothing. */
int _start(void)
{
    return 0;
}
