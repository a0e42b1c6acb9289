/* Write many rows as lines of JSON from their columns, in one call.
 *
 * `canonical` takes the columns apart; its `from_table` does the same in Python, for machines without a compiler;
 * tests require both to agree. What the arrays say about one another is checked, because they come from a file.
 */

#include "_codec.h"

#define ARRAYS 5

/* A column: what comes before each value, whether a row has one, and the values: integers, or places of texts, where text
 * k lies between the ends of k - 1 and k, each of which is a line feed. Of a column of lists, the places from starts[row]
 * to starts[row + 1] are the row's. */
typedef struct {
    const char *name;
    Py_ssize_t name_size, values_count, ends_count;
    const uint8_t *is_there;
    const int64_t *integers;
    const int32_t *places;
    const char *texts;
    const int64_t *ends, *starts;
    Py_buffer arrays[ARRAYS];
    int held;
} Column;

static int put_text(Written *out, const Column *column, int64_t place) {
    int64_t start = place ? column->ends[place - 1] + 1 : 0;
    return put(out, column->texts + start, column->ends[place] - start);
}

static int put_list(Written *out, const Column *column, Py_ssize_t row) {
    int failed = put(out, "[", 1);
    for (int64_t at = column->starts[row]; !failed && at < column->starts[row + 1]; at++) {
        if (at > column->starts[row]) failed = put(out, ",", 1);
        if (!failed) failed = put_text(out, column, column->places[at]);
    }
    return failed ? failed : put(out, "]", 1);
}

/* Write the rows. Returns -1 if there is not enough memory. */
static int put_rows(Written *out, const Column *columns, Py_ssize_t count, Py_ssize_t rows) {
    for (Py_ssize_t row = 0; row < rows; row++) {
        char before = '{';
        for (const Column *column = columns; column < columns + count; column++) {
            if (!column->is_there[row]) continue;
            if (put(out, &before, 1) || put(out, column->name, column->name_size)) return -1;
            before = ',';
            int failed = column->starts != NULL ? put_list(out, column, row)
                         : column->texts != NULL ? put_text(out, column, column->places[row])
                                                 : put_number(out, column->integers[row]);
            if (failed) return -1;
        }
        if ((before == '{' && put(out, "{", 1)) || put(out, "}\n", 2)) return -1;
    }
    return 0;
}

/* Return whether the arrays of a column are those of as many rows, and name only places that are there. */
static int is_sound(const Column *column, Py_ssize_t rows) {
    Py_ssize_t needed = rows;
    if (column->starts != NULL) {
        if (column->arrays[4].len != (rows + 1) * (Py_ssize_t)sizeof(int64_t) || column->texts == NULL) return 0;
        if (column->starts[0] != 0) return 0;
        for (Py_ssize_t row = 0; row < rows; row++)
            if (column->starts[row] > column->starts[row + 1]) return 0;
        needed = column->starts[rows];
    }
    if (column->arrays[0].len != rows || column->values_count != needed) return 0;
    if (column->texts == NULL) return 1;
    if (column->ends == NULL) return 0;
    for (Py_ssize_t at = 0, before = -1; at < column->ends_count; before = column->ends[at++])
        if (column->ends[at] <= before || column->ends[at] >= column->arrays[2].len) return 0;
    for (Py_ssize_t at = 0; at < column->values_count; at++) {
        int is_read = column->starts != NULL || column->is_there[at];
        if (is_read && (column->places[at] < 0 || column->places[at] >= column->ends_count)) return 0;
    }
    return 1;
}

/* Take the tuple (name, is_there, values, texts, ends, starts) apart; the last three may be None. */
static int take(Column *column, PyObject *given) {
    PyObject *found[ARRAYS];
    memset(column, 0, sizeof *column);
    if (!PyArg_ParseTuple(given, "y#OOOOO", &column->name, &column->name_size, found, found + 1, found + 2, found + 3,
                          found + 4))
        return -1;
    for (; column->held < ARRAYS; column->held++) {
        if (found[column->held] == Py_None) continue;
        if (PyObject_GetBuffer(found[column->held], column->arrays + column->held, PyBUF_SIMPLE) < 0) return -1;
    }
    column->is_there = column->arrays[0].buf, column->integers = column->arrays[1].buf;
    column->texts = column->arrays[2].buf, column->ends = column->arrays[3].buf, column->starts = column->arrays[4].buf;
    column->places = column->arrays[1].buf;
    column->values_count = column->arrays[1].len / (Py_ssize_t)(column->texts ? sizeof(int32_t) : sizeof(int64_t));
    column->ends_count = column->arrays[3].len / (Py_ssize_t)sizeof(int64_t);
    return 0;
}

PyObject *write_rows(PyObject *module, PyObject *args) {
    PyObject *given, *made = NULL;
    Py_ssize_t rows, count = 0;
    Written out = {NULL, 0, 0};
    int is_short = 0;
    (void)module;
    if (!PyArg_ParseTuple(args, "nO!", &rows, &PyList_Type, &given)) return NULL;
    Py_ssize_t all = PyList_Size(given);
    Column *columns = calloc(all ? all : 1, sizeof *columns);
    if (columns == NULL) return PyErr_NoMemory();
    for (; count < all; count++) {
        Column *column = columns + count;
        int failed = take(column, PyList_GetItem(given, count));
        if (!failed && !is_sound(column, rows))
            failed = (PyErr_Format(PyExc_ValueError, "column %zd: arrays that do not fit one another", count), 1);
        if (failed) {
            count++;
            goto done;
        }
    }
    Py_BEGIN_ALLOW_THREADS
    is_short = put_rows(&out, columns, count, rows);
    Py_END_ALLOW_THREADS
    made = is_short ? PyErr_NoMemory() : PyBytes_FromStringAndSize(out.data, (Py_ssize_t)out.size);
done:
    for (Py_ssize_t one = 0; one < count; one++)
        for (int at = 0; at < columns[one].held; at++)
            if (columns[one].arrays[at].obj != NULL) PyBuffer_Release(columns[one].arrays + at);
    free(columns);
    free(out.data);
    return made;
}
