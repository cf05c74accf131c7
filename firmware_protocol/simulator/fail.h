/* The error exit of the simulated board. */
#ifndef FAIL_H
#define FAIL_H

/* Print what cannot be used, with the reason if errno holds one, and exit with 2. */
_Noreturn void fail(const char *what);

#endif
