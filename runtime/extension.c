/* A CompiledFunction whose call is in C, built against the headers of this Python and this numpy.
 *
 * The call takes the arrays that are exactly what the function reads, doubles in the shape of the manifest, straight
 * into its inputs. Whatever else it is given goes to the class in Python: one place converts, one place complains.
 */
#define PY_SSIZE_T_CLEAN
#include <Python.h>
#define NPY_NO_DEPRECATED_API NPY_2_0_API_VERSION
#include <numpy/arrayobject.h>
#include <structmember.h>

/* What stands behind the slots of the class in Python, from `place` on. What it points to, `_binding` of that class
 * keeps. */
typedef struct {
  vectorcallfunc call;
  PyObject *names;   /* of the inputs, interned */
  PyObject *inputs;  /* their arrays */
  PyObject *outputs; /* what a call returns */
  int (*evaluate)(const void *);
  const void *evaluation;
} binding;

static Py_ssize_t place;

static binding *bound(PyObject *self) { return (binding *)(void *)((char *)self + place); }

/* Whether the value has been taken: no where it is not what the input is. */
static int taken(PyArrayObject *input, PyObject *value) {
  if (PyFloat_CheckExact(value) && PyArray_NDIM(input) == 0) {
    *(double *)PyArray_DATA(input) = PyFloat_AS_DOUBLE(value);
    return 1;
  }
  if (!PyArray_CheckExact(value)) return 0;
  PyArrayObject *const array = (PyArrayObject *)value;
  if (PyArray_TYPE(array) != NPY_DOUBLE || !PyArray_ISCARRAY_RO(array)) return 0;
  if (PyArray_NDIM(array) != PyArray_NDIM(input)) return 0;
  if (!PyArray_CompareLists(PyArray_DIMS(array), PyArray_DIMS(input), PyArray_NDIM(input))) return 0;
  memmove(PyArray_DATA(input), PyArray_DATA(array), (size_t)PyArray_NBYTES(input));
  return 1;
}

/* Writes one value into the input of that name; -1 with an exception set. */
static int write_input(PyObject *self, PyObject *name, PyObject *value) {
  const binding *const here = bound(self);
  const Py_ssize_t count = PyTuple_GET_SIZE(here->names);
  for (Py_ssize_t i = 0; i < count; ++i)
    if (PyTuple_GET_ITEM(here->names, i) == name) {
      if (taken((PyArrayObject *)PyTuple_GET_ITEM(here->inputs, i), value)) return 0;
      break;
    }
  PyObject *const nothing = PyObject_CallMethod(self, "_write", "OO", name, value);
  Py_XDECREF(nothing);
  return nothing ? 0 : -1;
}

static PyObject *call(PyObject *self, PyObject *const *values, size_t flags, PyObject *names) {
  if (PyVectorcall_NARGS(flags)) {
    PyErr_SetString(PyExc_TypeError, "the inputs of a function are given by name");
    return NULL;
  }
  const Py_ssize_t count = names ? PyTuple_GET_SIZE(names) : 0;
  for (Py_ssize_t i = 0; i < count; ++i)
    if (write_input(self, PyTuple_GET_ITEM(names, i), values[i])) return NULL;
  const binding *const here = bound(self);
  const int failed = here->evaluate(here->evaluation);
  if (failed) return PyObject_CallMethod(self, "_fail", "i", failed);
  return Py_NewRef(here->outputs);
}

/* Takes what the class in Python keeps as `_binding`. */
static PyObject *bind(PyObject *self, PyObject *kept) {
  binding *const here = bound(self);
  unsigned long long evaluate, evaluation;
  if (!PyArg_ParseTuple(kept, "O!O!OKK", &PyTuple_Type, &here->names, &PyTuple_Type, &here->inputs, &here->outputs,
                        &evaluate, &evaluation))
    return NULL;
  here->evaluate = (int (*)(const void *))(uintptr_t)evaluate;
  here->evaluation = (const void *)(uintptr_t)evaluation;
  here->call = call;
  Py_RETURN_NONE;
}

static PyMethodDef of_the_class[] = {
    {"_bind", bind, METH_O, "Take what a call needs."},
    {NULL, NULL, 0, NULL},
};

/* The class derived from one in Python that is called here. */
static PyObject *called_in_c(PyObject *module, PyObject *base) {
  (void)module;
  if (!PyType_Check(base)) return PyErr_Format(PyExc_TypeError, "wanted a class, got %R", base);
  place = ((PyTypeObject *)base)->tp_basicsize;
  PyMemberDef members[] = {
      {"__vectorcalloffset__", T_PYSSIZET, place + (Py_ssize_t)offsetof(binding, call), READONLY, NULL},
      {NULL, 0, 0, 0, NULL},
  };
  PyType_Slot slots[] = {
      {Py_tp_call, (void *)PyVectorcall_Call}, {Py_tp_methods, of_the_class}, {Py_tp_members, members}, {0, NULL}};
  PyType_Spec spec = {
      .name = "clikgen.runtime.controller.CompiledFunction",
      .basicsize = (int)(place + (Py_ssize_t)sizeof(binding)),
      .flags = Py_TPFLAGS_DEFAULT | Py_TPFLAGS_HAVE_VECTORCALL,
      .slots = slots,
  };
  return PyType_FromSpecWithBases(&spec, base);
}

static PyMethodDef methods[] = {
    {"called_in_c", called_in_c, METH_O, "The class derived from CompiledFunction whose call is in C."},
    {NULL, NULL, 0, NULL},
};

static int execute(PyObject *module) {
  (void)module;
  import_array1(-1);
  return 0;
}

static PyModuleDef_Slot slots[] = {{Py_mod_exec, (void *)execute}, {0, NULL}};

static struct PyModuleDef definition = {
    .m_base = PyModuleDef_HEAD_INIT, .m_name = "extension", .m_methods = methods, .m_slots = slots};

PyMODINIT_FUNC PyInit_extension(void) { return PyModuleDef_Init(&definition); }
