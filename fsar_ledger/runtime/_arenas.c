/* Give Python's small objects memory in large pages, where the system has them.
 *
 * A fleet of thousands has a gigabyte of small objects, of which each event needs others. In pages of 4 KiB, finding the
 * page of an object takes as long as fetching the object. `arenas.py` says when this is used. The limited API has no
 * arenas, so this is built for one version of Python.
 */

#define PY_SSIZE_T_CLEAN
#include <Python.h>
#include <stdint.h>
#include <sys/mman.h>

#define PAGE_BYTES ((size_t)2 << 20)
#define BLOCK_BYTES ((size_t)32 << 20) /* what is asked of the system at once */
#define MAX_BLOCKS 4096

static PyObjectArenaAllocator before;
static char *blocks[MAX_BLOCKS];
static int count;
static char *next, *end;  /* what is left of the newest block */
static void **spare;      /* arenas that were given back, each with the place of the one before in its first bytes */
static size_t arena_bytes; /* all are of one size, but for what the system gives */

static int begin_block(void) {
    if (count == MAX_BLOCKS) return -1;
    char *place = mmap(NULL, BLOCK_BYTES + PAGE_BYTES, PROT_READ | PROT_WRITE, MAP_PRIVATE | MAP_ANONYMOUS, -1, 0);
    if (place == MAP_FAILED) return -1;
    next = (char *)(((uintptr_t)place + PAGE_BYTES - 1) & ~(uintptr_t)(PAGE_BYTES - 1));
    end = next + BLOCK_BYTES;
    blocks[count++] = next;
    madvise(next, BLOCK_BYTES, MADV_HUGEPAGE); /* a wish: without large pages, it is memory as any other */
    return 0;
}

static void *give(void *context, size_t size) {
    (void)context;
    if (arena_bytes == 0 && size <= BLOCK_BYTES) arena_bytes = size;
    if (size != arena_bytes) return before.alloc(before.ctx, size);
    if (spare != NULL) {
        void **found = spare;
        spare = *found;
        return found;
    }
    if ((size_t)(end - next) < size && begin_block() < 0) return before.alloc(before.ctx, size);
    void *found = next;
    next += size;
    return found;
}

static void take_back(void *context, void *arena, size_t size) {
    (void)context;
    for (int at = 0; at < count; at++)
        if ((char *)arena >= blocks[at] && (char *)arena < blocks[at] + BLOCK_BYTES) {
            *(void **)arena = spare, spare = arena;
            return;
        }
    before.free(before.ctx, arena, size); /* it was given before this was installed */
}

static PyObject *install(PyObject *module, PyObject *nothing) {
    PyObjectArenaAllocator own = {NULL, give, take_back};
    (void)module, (void)nothing;
    if (before.alloc == NULL) {
        PyObject_GetArenaAllocator(&before);
        PyObject_SetArenaAllocator(&own);
    }
    Py_RETURN_NONE;
}

static PyMethodDef METHODS[] = {
    {"install", install, METH_NOARGS, "Give small objects memory in large pages from now on."},
    {NULL, NULL, 0, NULL},
};

static struct PyModuleDef MODULE = {PyModuleDef_HEAD_INIT, "_arenas", NULL, 0, METHODS, NULL, NULL, NULL, NULL};

PyMODINIT_FUNC PyInit__arenas(void) { return PyModule_Create(&MODULE); }
