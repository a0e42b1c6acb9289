/* What the three directions of the codec share: how text is written, and what `_codec.c` makes a module of. */

#ifndef FSAR_CODEC
#define FSAR_CODEC

#define PY_SSIZE_T_CLEAN
#define Py_LIMITED_API 0x030b0000
#include <Python.h>
#include <stdint.h>
#include <stdlib.h>
#include <string.h>

#define MAX_INTEGER 9007199254740991 /* 2^53 - 1 */

typedef struct {
    char *data;
    size_t size, room;
} Written;

/* Write bytes. Returns -1 if there is not enough memory; sets no exception, since other threads may run meanwhile. */
static inline int put(Written *out, const char *data, size_t size) {
    if (out->room - out->size < size) {
        size_t room = out->room * 2 + size + 1024;
        char *grown = realloc(out->data, room);
        if (grown == NULL) return -1;
        out->data = grown, out->room = room;
    }
    memcpy(out->data + out->size, data, size);
    out->size += size;
    return 0;
}

static inline int put_number(Written *out, int64_t value) {
    char digits[20];
    int at = sizeof digits;
    uint64_t rest = value < 0 ? 0 - (uint64_t)value : (uint64_t)value;
    do digits[--at] = (char)('0' + rest % 10);
    while (rest /= 10);
    if (value < 0) digits[--at] = '-';
    return put(out, digits + at, sizeof digits - at);
}

PyObject *event_types(PyObject *module, PyObject *given);
PyObject *write_events(PyObject *module, PyObject *args);
PyObject *write_rows(PyObject *module, PyObject *args);
PyObject *read_rows(PyObject *module, PyObject *args);

#endif
