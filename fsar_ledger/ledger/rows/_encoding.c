/* Write the events of a run as lines of JSON, straight from their structs, in one call.
 *
 * Only what is plain is written: events of types that are known, with values of the classes, sizes and lists that their
 * fields allow, and text of printable ASCII that JSON does not escape. For anything else the answer is None, and Python
 * code says what is wrong, or writes it (`encoding.py`). Tests require both to agree.
 */

#define PY_SSIZE_T_CLEAN
#define Py_LIMITED_API 0x030b0000
#include <Python.h>
#include <stdint.h>
#include <stdlib.h>
#include <string.h>

#define MAX_INTEGER 9007199254740991 /* 2^53 - 1 */
#define MAX_DIGITS 20

/* What a column holds: a value of the event, or one that every row has. As in `encoding.py`. */
enum { STRING, INTEGER, BOOLEAN, STRINGS, RUN_ID, SEQ, TIME_US, CAUSED_BY, TYPE };

/* How writing went on. */
enum { WRITTEN, NOT_PLAIN, FAILED };

typedef struct {
    char *data;
    size_t size, room;
} Written;

/* What a row has beside its event. */
typedef struct {
    PyObject *run_id, *time, *cause;
    long long seq;
} Place;

static int put(Written *out, const char *data, size_t size) {
    if (out->room - out->size < size) {
        size_t room = out->room * 2 + size;
        char *grown = realloc(out->data, room);
        if (grown == NULL) return PyErr_NoMemory(), FAILED;
        out->data = grown, out->room = room;
    }
    memcpy(out->data + out->size, data, size);
    out->size += size;
    return WRITTEN;
}

static int put_number(Written *out, long long value) {
    char digits[MAX_DIGITS];
    int at = MAX_DIGITS;
    unsigned long long rest = value < 0 ? 0 - (unsigned long long)value : (unsigned long long)value;
    do digits[--at] = (char)('0' + rest % 10);
    while (rest /= 10);
    if (value < 0) digits[--at] = '-';
    return put(out, digits + at, MAX_DIGITS - at);
}

static int put_integer(Written *out, PyObject *value, long long least, long long most) {
    int is_beyond = 0;
    if (!PyLong_CheckExact(value)) return NOT_PLAIN;
    long long number = PyLong_AsLongLongAndOverflow(value, &is_beyond);
    if (is_beyond || number < least || number > most) return NOT_PLAIN;
    return put_number(out, number);
}

static int put_text(Written *out, PyObject *value) {
    Py_ssize_t size;
    if (!PyUnicode_CheckExact(value)) return NOT_PLAIN;
    const char *text = PyUnicode_AsUTF8AndSize(value, &size);
    if (text == NULL) return PyErr_Clear(), NOT_PLAIN; /* it has surrogates */
    for (const char *at = text; at < text + size; at++)
        if (*at < ' ' || *at > '~' || *at == '"' || *at == '\\') return NOT_PLAIN; /* char may be signed: both end there */
    int how = put(out, "\"", 1);
    if (how == WRITTEN) how = put(out, text, size);
    return how == WRITTEN ? put(out, "\"", 1) : how;
}

static int put_texts(Written *out, PyObject *values) {
    if (!PyTuple_CheckExact(values)) return NOT_PLAIN;
    int how = put(out, "[", 1);
    for (Py_ssize_t at = 0; how == WRITTEN && at < PyTuple_Size(values); at++) {
        if (at) how = put(out, ",", 1);
        if (how == WRITTEN) how = put_text(out, PyTuple_GetItem(values, at));
    }
    return how == WRITTEN ? put(out, "]", 1) : how;
}

static int put_value(Written *out, long kind, PyObject *value, PyObject *values) {
    if (kind == INTEGER) return put_integer(out, value, -MAX_INTEGER, MAX_INTEGER);
    if (kind == STRINGS) return put_texts(out, value);
    if (kind == BOOLEAN) {
        if (value != Py_True && value != Py_False) return NOT_PLAIN;
        return value == Py_True ? put(out, "true", 4) : put(out, "false", 5);
    }
    int how = put_text(out, value);
    if (how != WRITTEN || values == Py_None) return how;
    int is_listed = PySet_Contains(values, value);
    return is_listed < 0 ? FAILED : is_listed ? WRITTEN : NOT_PLAIN;
}

static int put_place(Written *out, long kind, const Place *place, PyObject *tag) {
    if (kind == SEQ) return put_number(out, place->seq);
    if (kind == TIME_US) return put_integer(out, place->time, -MAX_INTEGER, MAX_INTEGER);
    if (kind == CAUSED_BY) return put_integer(out, place->cause, 0, place->seq - 1);
    return put_text(out, kind == RUN_ID ? place->run_id : tag);
}

/* Return a new reference to the value of the event for this column; NULL if it has none, or its part is of another class. */
static PyObject *value_of(PyObject *event, PyObject *member, PyObject *part, PyObject *field) {
    PyObject *found = PyObject_GetAttr(event, member);
    if (found == NULL || part == Py_None) return found;
    PyObject *value = (PyObject *)Py_TYPE(found) == part ? PyObject_GetAttr(found, field) : NULL;
    Py_DECREF(found);
    return value;
}

/* Write a member of the row, with what comes before it: (kind, name, member, part, field, nullable, values). */
static int put_column(Written *out, PyObject *column, PyObject *event, const Place *place, char *before) {
    PyObject *found[7];
    if (!PyTuple_Check(column) || PyTuple_Size(column) != 7)
        return PyErr_SetString(PyExc_TypeError, "a column: expected a tuple of 7"), FAILED;
    for (int at = 0; at < 7; at++) found[at] = PyTuple_GetItem(column, at);
    long kind = PyLong_AsLong(found[0]);
    Py_ssize_t size;
    char *name;
    if ((kind == -1 && PyErr_Occurred()) || PyBytes_AsStringAndSize(found[1], &name, &size) < 0) return FAILED;
    int is_value = kind < RUN_ID;
    PyObject *value = is_value ? value_of(event, found[2], found[3], found[4]) : NULL;
    if (is_value && value == NULL) return PyErr_Clear(), NOT_PLAIN;
    int how = WRITTEN;
    if (is_value ? value == Py_None : kind == CAUSED_BY && place->cause == Py_None) {
        int is_allowed = is_value ? found[5] == Py_True : place->seq == 0;
        how = is_allowed ? WRITTEN : NOT_PLAIN;
    } else {
        how = put(out, before, 1);
        *before = ',';
        if (how == WRITTEN) how = put(out, name, size);
        if (how == WRITTEN)
            how = is_value ? put_value(out, kind, value, found[6]) : put_place(out, kind, place, found[4]);
    }
    Py_XDECREF(value);
    return how;
}

static int put_row(Written *out, PyObject *types, PyObject *event, const Place *place) {
    PyObject *columns = PyDict_GetItemWithError(types, (PyObject *)Py_TYPE(event));
    if (columns == NULL) return PyErr_Occurred() ? FAILED : NOT_PLAIN;
    if (!PyTuple_Check(columns)) return PyErr_SetString(PyExc_TypeError, "columns: expected a tuple"), FAILED;
    char before = '{';
    int how = WRITTEN;
    Py_INCREF(columns); /* getting an attribute may run Python code */
    for (Py_ssize_t at = 0; how == WRITTEN && at < PyTuple_Size(columns); at++)
        how = put_column(out, PyTuple_GetItem(columns, at), event, place, &before);
    Py_DECREF(columns);
    return how == WRITTEN ? put(out, "}\n", 2) : how;
}

static PyObject *lines(PyObject *module, PyObject *args) {
    PyObject *types, *times, *causes, *events, *made = NULL;
    Place place;
    Written out = {NULL, 0, 0};
    (void)module;
    if (!PyArg_ParseTuple(args, "O!OLO!O!O!", &PyDict_Type, &types, &place.run_id, &place.seq, &PyList_Type, &times,
                          &PyList_Type, &causes, &PyList_Type, &events))
        return NULL;
    Py_ssize_t rows = PyList_Size(events);
    int how = PyList_Size(times) == rows && PyList_Size(causes) == rows ? WRITTEN : NOT_PLAIN;
    for (Py_ssize_t row = 0; how == WRITTEN && row < rows; row++, place.seq++) {
        PyObject *event = PyList_GetItem(events, row);
        place.time = PyList_GetItem(times, row), place.cause = PyList_GetItem(causes, row);
        if (event == NULL || place.time == NULL || place.cause == NULL) {
            how = FAILED;
            break;
        }
        Py_INCREF(event), Py_INCREF(place.time), Py_INCREF(place.cause);
        how = put_row(&out, types, event, &place);
        Py_DECREF(event), Py_DECREF(place.time), Py_DECREF(place.cause);
    }
    if (how == WRITTEN) made = PyBytes_FromStringAndSize(out.data, (Py_ssize_t)out.size);
    if (how == NOT_PLAIN) Py_INCREF(Py_None), made = Py_None;
    free(out.data);
    return made;
}

static PyMethodDef METHODS[] = {
    {"lines", lines, METH_VARARGS, "Return the events of a run as lines of JSON; None if they are not plain."},
    {NULL, NULL, 0, NULL},
};

static struct PyModuleDef MODULE = {PyModuleDef_HEAD_INIT, "_encoding", NULL, 0, METHODS, NULL, NULL, NULL, NULL};

PyMODINIT_FUNC PyInit__encoding(void) { return PyModule_Create(&MODULE); }
