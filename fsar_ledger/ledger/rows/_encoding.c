/* Write the events of a run as lines of JSON, straight from their structs, in one call.
 *
 * Only what is plain is written: events of types that are known, with values of the classes, sizes and lists that their
 * fields allow, and text of printable ASCII. For anything else the answer is None, and Python code says what is wrong, or
 * writes it (`encoding.py`). Tests require both to agree.
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
        size_t room = out->room * 2 + size + 1024;
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

/* Write text of printable ASCII as JSON, which escapes the quotation mark and the backslash. */
static int put_text(Written *out, PyObject *value) {
    Py_ssize_t size;
    int escapes = 0;
    if (!PyUnicode_CheckExact(value)) return NOT_PLAIN;
    const char *text = PyUnicode_AsUTF8AndSize(value, &size);
    if (text == NULL) return PyErr_Clear(), NOT_PLAIN; /* it has surrogates */
    for (const char *at = text; at < text + size; at++) {
        if (*at < ' ' || *at > '~') return NOT_PLAIN; /* char may be signed: both end there */
        escapes += *at == '"' || *at == '\\';
    }
    int how = put(out, "\"", 1);
    for (const char *end = text + size; how == WRITTEN && escapes; escapes--) {
        const char *at = text;
        while (*at != '"' && *at != '\\') at++;
        how = put(out, text, (size_t)(at - text));
        if (how == WRITTEN) how = put(out, *at == '"' ? "\\\"" : "\\\\", 2);
        text = at + 1, size = end - text;
    }
    if (how == WRITTEN) how = put(out, text, (size_t)size);
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

/* A column of an event type: its kind, what comes before its value, where the event has it, and what it may be. */
typedef struct {
    long kind;
    const char *name;
    Py_ssize_t name_size;
    PyObject *member, *part, *field, *values;
    int is_nullable;
} Column;

typedef struct {
    PyObject *class;
    Column *columns;
    Py_ssize_t count;
} Type;

/* The event types that are known, found by the address of their class; `given` is what they were made from. */
typedef struct {
    PyObject *given;
    Type *types;
    size_t slots;
} Types;

#define TYPES "fsar_ledger.ledger.rows._encoding.types"

static Type *type_of(const Types *all, PyObject *class) {
    size_t slot = ((uintptr_t)class >> 4) % all->slots;
    while (all->types[slot].class != NULL && all->types[slot].class != class) slot = (slot + 1) % all->slots;
    return all->types + slot;
}

/* Return a new reference to the value of the event for this column; NULL if it has none, or its part is of another class. */
static PyObject *value_of(PyObject *event, const Column *column) {
    PyObject *found = PyObject_GetAttr(event, column->member);
    if (found == NULL || column->part == Py_None) return found;
    PyObject *value = (PyObject *)Py_TYPE(found) == column->part ? PyObject_GetAttr(found, column->field) : NULL;
    Py_DECREF(found);
    return value;
}

/* Write a member of the row, with what comes before it. */
static int put_column(Written *out, const Column *column, PyObject *event, const Place *place, char *before) {
    int is_value = column->kind < RUN_ID;
    PyObject *value = is_value ? value_of(event, column) : NULL;
    if (is_value && value == NULL) return PyErr_Clear(), NOT_PLAIN;
    int how = WRITTEN;
    if (is_value ? value == Py_None : column->kind == CAUSED_BY && place->cause == Py_None) {
        int is_allowed = is_value ? column->is_nullable : place->seq == 0;
        how = is_allowed ? WRITTEN : NOT_PLAIN;
    } else {
        how = put(out, before, 1);
        *before = ',';
        if (how == WRITTEN) how = put(out, column->name, column->name_size);
        if (how == WRITTEN)
            how = is_value ? put_value(out, column->kind, value, column->values)
                           : put_place(out, column->kind, place, column->field);
    }
    Py_XDECREF(value);
    return how;
}

static int put_row(Written *out, const Types *types, PyObject *event, const Place *place) {
    const Type *type = type_of(types, (PyObject *)Py_TYPE(event));
    if (type->class == NULL) return NOT_PLAIN;
    char before = '{';
    int how = WRITTEN;
    for (const Column *column = type->columns; how == WRITTEN && column < type->columns + type->count; column++)
        how = put_column(out, column, event, place, &before);
    return how == WRITTEN ? put(out, "}\n", 2) : how;
}

/* Take (kind, name, member, part, field, nullable, values) apart. What it holds is kept by `given`. */
static int take_column(Column *column, PyObject *given) {
    if (!PyTuple_Check(given)) return PyErr_SetString(PyExc_TypeError, "a column: expected a tuple of 7"), -1;
    return PyArg_ParseTuple(given, "ly#OOOpO", &column->kind, &column->name, &column->name_size, &column->member,
                            &column->part, &column->field, &column->is_nullable, &column->values)
               ? 0
               : -1;
}

static void release(PyObject *capsule) {
    Types *all = PyCapsule_GetPointer(capsule, TYPES);
    for (size_t slot = 0; slot < all->slots; slot++) free(all->types[slot].columns);
    Py_XDECREF(all->given);
    free(all->types), free(all);
}

/* Return the types of {class: (column, ...)} as `lines` takes them. The tuples must not change, and cannot. */
static PyObject *types(PyObject *module, PyObject *given) {
    PyObject *class, *columns;
    Py_ssize_t at = 0;
    (void)module;
    if (!PyDict_Check(given)) return PyErr_SetString(PyExc_TypeError, "types: expected a dict"), NULL;
    Types *all = calloc(1, sizeof *all);
    PyObject *capsule = all == NULL ? PyErr_NoMemory() : PyCapsule_New(all, TYPES, release);
    if (capsule == NULL) return free(all), NULL;
    size_t slots = (size_t)PyDict_Size(given) * 2 + 1;
    all->types = calloc(slots, sizeof *all->types), all->given = PyDict_Copy(given);
    if (all->types == NULL || all->given == NULL) return Py_DECREF(capsule), PyErr_NoMemory();
    all->slots = slots;
    while (PyDict_Next(all->given, &at, &class, &columns)) {
        Type *type = type_of(all, class);
        type->class = class;
        if (!PyTuple_Check(columns)) {
            PyErr_SetString(PyExc_TypeError, "columns: expected a tuple");
            return Py_DECREF(capsule), NULL;
        }
        type->columns = calloc((size_t)PyTuple_Size(columns) + 1, sizeof *type->columns);
        if (type->columns == NULL) return Py_DECREF(capsule), PyErr_NoMemory();
        for (; type->count < PyTuple_Size(columns); type->count++)
            if (take_column(type->columns + type->count, PyTuple_GetItem(columns, type->count)) < 0)
                return Py_DECREF(capsule), NULL;
    }
    return capsule;
}

static PyObject *lines(PyObject *module, PyObject *args) {
    PyObject *capsule, *times, *causes, *events, *made = NULL;
    Place place;
    Written out = {NULL, 0, 0};
    (void)module;
    if (!PyArg_ParseTuple(args, "OOLO!O!O!", &capsule, &place.run_id, &place.seq, &PyList_Type, &times, &PyList_Type, &causes,
                          &PyList_Type, &events))
        return NULL;
    const Types *all = PyCapsule_GetPointer(capsule, TYPES);
    if (all == NULL) return NULL;
    Py_ssize_t rows = PyList_Size(events);
    int how = PyList_Size(times) == rows && PyList_Size(causes) == rows ? WRITTEN : NOT_PLAIN;
    for (Py_ssize_t row = 0; how == WRITTEN && row < rows; row++, place.seq++) {
        PyObject *event = PyList_GetItem(events, row);
        place.time = PyList_GetItem(times, row), place.cause = PyList_GetItem(causes, row);
        if (event == NULL || place.time == NULL || place.cause == NULL) {
            how = FAILED; /* getting an attribute ran Python code, and that made the lists shorter */
            break;
        }
        Py_INCREF(event), Py_INCREF(place.time), Py_INCREF(place.cause);
        how = put_row(&out, all, event, &place);
        Py_DECREF(event), Py_DECREF(place.time), Py_DECREF(place.cause);
    }
    if (how == WRITTEN) made = PyBytes_FromStringAndSize(out.data, (Py_ssize_t)out.size);
    if (how == NOT_PLAIN) Py_INCREF(Py_None), made = Py_None;
    free(out.data);
    return made;
}

static PyMethodDef METHODS[] = {
    {"types", types, METH_O, "Return event types and their columns as lines takes them."},
    {"lines", lines, METH_VARARGS, "Return the events of a run as lines of JSON; None if they are not plain."},
    {NULL, NULL, 0, NULL},
};

static struct PyModuleDef MODULE = {PyModuleDef_HEAD_INIT, "_encoding", NULL, 0, METHODS, NULL, NULL, NULL, NULL};

PyMODINIT_FUNC PyInit__encoding(void) { return PyModule_Create(&MODULE); }
