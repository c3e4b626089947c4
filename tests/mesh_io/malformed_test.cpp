// Files that are wrong, each with the error it must get: one line that names the file and what is wrong.

#include <gtest/gtest.h>

#include <cstring>
#include <random>

#include "server/mesh_io/mesh_error.hpp"
#include "server/mesh_io/mesh_io.hpp"
#include "tests/mesh_io/test_meshes.hpp"

namespace incise::mesh_io {
namespace {

using namespace testing;

struct BadFile {
  const char* ending;
  std::string_view bytes;
  const char* error;  // a part of it
};

using namespace std::string_view_literals;

constexpr const char* kGoodNodes = "4 3 0 0\n0 0 0 0\n1 1 0 0\n2 0 1 0\n3 0 0 1\n";

// a.node comes with kGoodNodes's .ele: 1 tetrahedron 0 1 2 3.
const BadFile kBadNodes[] = {
    {"node", "", "a.node: the file is empty"},
    {"node", "\n\n# nothing\n", "a.node: ends after line 3, where the header"},
    {"node", "4\n0 0 0 0\n1 1 0 0\n2 0 1 0\n3 0 0 1\n", "a.node:1: the dimension is missing"},
    {"node", "x 3 0 0\n", "a.node:1: the number of points is 'x', not an integer"},
    {"node", "4.5 3 0 0\n", "not an integer"},
    {"node", "-4 3 0 0\n", "the number of points is -4"},
    {"node", "99999999999999999999 3 0 0\n", "not an integer"},
    {"node", "4000000000 3 0 0\n0 0 0 0\n", "the number of points is 4000000000; at most"},
    {"node", "0 3 0 0\n", "a tetrahedron needs four"},
    {"node", "300 2 0 0\n1 0 0\n2 1 0\n", "a.node:1: the dimension is not 3 but 2: a flat mesh"},
    {"node", "4 2 0 0\n0 0 0\n1 1 0\n2 0 1\n3 1 1\n", "a.node:1: the dimension is not 3"},
    {"node", "4 3 0 0\n0 0 0 0\n1 1 0 0\n2 0 1 0\n",
     "a.node: ends after line 4, where point 4 of 4 should be"},
    {"node", "4 3 0 0\n0 0 0 0\n1 1 0 0\n2 0 1 0\n3 0 0 1\n4 1 1 1\n",
     "a.node:6: a line after the last of the 4 points"},
    {"node", "4 3 0 0\n0 0 0 0\n1 1 0 0\n3 0 1 0\n4 0 0 1\n", "a.node:4: the point's index is 3, expected 2"},
    {"node", "4 3 0 0\n5 0 0 0\n6 1 0 0\n7 0 1 0\n8 0 0 1\n", "a.node:2: the point's index is 5, expected 0"},
    {"node", "4 3 0 0\n0 0 0 0\n1 1 0\n2 0 1 0\n3 0 0 1\n", "a.node:3: the coordinate z is missing"},
    {"node", "4 3 0 0\n0 0 0 0\n1 1 nan 0\n2 0 1 0\n3 0 0 1\n",
     "a.node:3: the coordinate y is 'nan', not a finite"},
    {"node", "4 3 0 0\n0 0 0 inf\n1 1 0 0\n2 0 1 0\n3 0 0 1\n", "a.node:2: the coordinate z is 'inf'"},
    {"node", "4 3 0 0\n0 0 0 0\n1 1e999 0 0\n2 0 1 0\n3 0 0 1\n", "'1e999', not a finite number"},
    {"node", "4 3 0 0\n0 0 0 0\n1 1,5 0 0\n2 0 1 0\n3 0 0 1\n", "'1,5', not a number"},
    {"node", "4 3 0 0\n0 0 0 0\n1 0x1p3 0 0\n2 0 1 0\n3 0 0 1\n", "'0x1p3', not a number"},
    {"node", "4 3 0 0\n0 0 0 0\n1 1e80 0 0\n2 0 1 0\n3 0 0 1\n", "lies beyond 1e+60 m"},
    {"node", "4 3 0 0\n0 0 0 0\n1 1 0 0\n2 2 0 0\n3 3 0 0\n", "no tetrahedron of positive volume is left"},
    {"node", "4 3 0 0\n0 0 0 0\n1 0 0 0\n2 0 0 0\n3 0 0 0\n", "no tetrahedron of positive volume is left"},
    {"node", "\x7f\x45LF\x02\x01\x01\0\0\0\0\0"sv, "not an integer"},
    {"node", "<!DOCTYPE html>\n<html>\n", "not an integer"},
    {"node", "version https://git-lfs.github.com/spec/v1\noid sha256:00\n", "not an integer"},
};

// a.ele comes with kGoodNodes.
const BadFile kBadElements[] = {
    {"ele", "", "a.ele: the file is empty"},
    {"ele", "#\n", "a.ele: ends after line 1, where the header"},
    {"ele", "0 4 0\n", "the number of tetrahedra is 0"},
    {"ele", "-1 4 0\n", "the number of tetrahedra is -1"},
    {"ele", "2000000000 4 0\n0 0 1 2 3\n", "at most"},
    {"ele", "1 5 0\n0 0 1 2 3 3\n", "tetrahedra of 5 nodes; 4 and 10"},
    {"ele", "1 4 0\n", "a.ele: ends after line 1, where tetrahedron 1 of 1"},
    {"ele", "1 4 0\n0 0 1 2\n", "a.ele:2: the index of a node is missing"},
    {"ele", "1 4 0\n0 0 1 2 x\n", "a.ele:2: the index of a node is 'x'"},
    {"ele", "1 4 0\n0 0 1 2 4\n", "a.ele:2: the node 4 does not exist; the .node file has 0 to 3"},
    {"ele", "1 4 0\n0 0 1 2 -1\n", "a.ele:2: the node -1 does not exist"},
    {"ele", "1 4 0\n0 0 1 2 4294967296\n", "the node 4294967296 does not exist"},
    {"ele", "1 4 0\n0 0 1 2 2\n", "tetrahedron 0 has vertex 2 at (0, 1, 0) twice"},
    {"ele", "1 4 0\n7 0 1 2 3\n", "the tetrahedron's index is 7"},
    {"ele", "1 4 0\n0 0 1 2 3\n1 0 1 2 3\n", "a.ele:3: a line after the last of the 1 tetrahedra"},
    {"ele", "1 4 1\n0 0 1 2 3\n", "a.ele:2: the region attribute is missing"},
    {"ele", "1 4 1\n0 0 1 2 3 1e300\n",
     "the region attribute is out of range; accepted are -2147483647 to 2147483647"},
    {"ele", "1 4 1\n0 0 1 2 3 nan\n", "the region attribute is 'nan'"},
    {"ele", "2 4 0\n0 0 1 2 3\n1 0 1 2 3\n", "tetrahedron 0 and 1 have the same vertices 0, 1, 2, 3"},
    {"ele", "2 4 0\n0 0 1 2 3\n1 3 1 0 2\n", "have the same vertices"},
    {"ele", "1 four 0\n0 0 1 2 3\n", "the number of nodes a tetrahedron is 'four'"},
};

const BadFile kBadSurfaces[] = {
    {"stl", "", "a.stl: the file is empty"},
    {"stl", "hello",
     "neither ASCII STL (it does not start with 'solid') nor binary STL (shorter than its header"},
    {"stl", "solid a\nendsolid a\n", "a.stl: there is no triangle"},
    {"stl",
     "solid a\nfacet normal 0 0 1\nouter loop\nvertex 0 0 0\nvertex 1 0 0\nendloop\nendfacet\nendsolid\n",
     "a.stl:6: a facet of 2 vertices"},
    {"stl", "solid a\nfacet\nouter loop\nvertex 0 0 0\nvertex 1 0 0\nvertex 1 1 0\nvertex 0 1 0\nendloop\n",
     "a.stl:7: a fourth vertex in a facet"},
    {"stl", "solid a\nvertex 0 0 0\n", "a.stl:2: 'vertex' outside of 'outer loop'"},
    {"stl", "solid a\nfacet normal 0 0 1\nouter loop\nvertex 0 0\n", "a.stl:4: the coordinate z is missing"},
    {"stl", "solid a\nfacet normal 0 0 1\nouter loop\nvertex 0 0 nan\n",
     "a.stl:4: the coordinate z is 'nan'"},
    {"stl",
     "solid a\nfacet normal 0 0 1\nouter loop\nvertex 0 0 0\nvertex 1 0 0\nvertex 0 1 0\nendloop\nendfacet\n",
     "without 'endsolid': the file is cut short"},
    {"stl", "solid a\nouter loop\nouter loop\n", "a.stl:3: 'outer loop' inside of another"},
    {"stl", "solid a\nfacette\n", "a.stl:2: 'solid', 'facet'"},
    {"stl",
     "solid a\nfacet\nouter loop\nvertex 0 0 0\nvertex 1 0 0\nvertex 0 1 0\nendloop\nendfacet\nendsolid\n",
     "the surface is open: 3 edges have one triangle only"},
    {"ply", "", "a.ply: the file is empty"},
    {"ply", "plx\n", "a.ply:1: a PLY file starts with the line 'ply'"},
    {"ply", "ply\n", "where 'format' should be"},
    {"ply", "ply\nformat ebcdic 1.0\n", "a.ply:2: the format is none of"},
    {"ply", "ply\nelement vertex 3\n", "the second line is 'format KIND 1.0'"},
    {"ply", "ply\nformat ascii 1.0\nelement vertex 3\n", "where 'end_header' should be"},
    {"ply", "ply\nformat ascii 1.0\nelement vertex -3\n", "a.ply:3: the number of elements is -3"},
    {"ply", "ply\nformat ascii 1.0\nproperty float x\n", "a.ply:3: a property before the first element"},
    {"ply", "ply\nformat ascii 1.0\nelement vertex 3\nproperty half x\n",
     "a.ply:4: the type of the property"},
    {"ply", "ply\nformat ascii 1.0\nelement vertex 3\nproperty list float int x\n",
     "a list is counted in integers"},
    {"ply", "ply\nformat ascii 1.0\nelement vertex 3\nproperty float\n", "'property TYPE NAME'"},
    {"ply", "ply\nformat ascii 1.0\nnonsense\n", "a.ply:3: 'element', 'property'"},
    {"ply", "ply\nformat ascii 1.0\nend_header\n", "the header has no element 'vertex'"},
    {"ply",
     "ply\nformat ascii 1.0\nelement vertex 0\nproperty float x\nproperty float y\nproperty float "
     "z\nend_header\n",
     "the header has no element 'face'"},
    {"ply",
     "ply\nformat ascii 1.0\nelement vertex 3\nproperty float x\nproperty float y\nelement face 1\n"
     "property list uchar int vertex_indices\nend_header\n",
     "has no property 'z'"},
    {"ply",
     "ply\nformat ascii 1.0\nelement vertex 3\nproperty float x\nproperty float y\nproperty float z\n"
     "element face 1\nproperty list uchar float vertex_indices\nend_header\n",
     "no list of integers"},
    {"ply",
     "ply\nformat ascii 1.0\nelement vertex 999999999\nproperty float x\nproperty float y\nproperty float z\n"
     "element face 1\nproperty list uchar int vertex_indices\nend_header\n0 0 0\n",
     "more than the"},
    {"ply",
     "ply\nformat ascii 1.0\nelement vertex 3\nproperty float x\nproperty float y\nproperty float z\n"
     "element face 1\nproperty list uchar int vertex_indices\nend_header\n0 0 0\n1 0 0\n0 1 0\n3 0 1 3\n",
     "a.ply:13: face 0: vertex 3 does not exist"},
    {"ply",
     "ply\nformat ascii 1.0\nelement vertex 3\nproperty float x\nproperty float y\nproperty float z\n"
     "element face 1\nproperty list uchar int vertex_indices\nend_header\n0 0 0\n1 0 0\n0 1 0\n2 0 1\n",
     "a list of 2 values"},
    {"ply",
     "ply\nformat ascii 1.0\nelement vertex 3\nproperty float x\nproperty float y\nproperty float z\n"
     "element face 1\nproperty list uchar int vertex_indices\nend_header\n0 0 0\n1 0 x\n0 1 0\n3 0 1 2\n",
     "a.ply:11: a value of vertex 1 is 'x'"},
    {"ply",
     "ply\nformat ascii 1.0\nelement vertex 3\nproperty float x\nproperty float y\nproperty float z\n"
     "element face 1\nproperty list uchar int vertex_indices\nend_header\n0 0 0\n1 0 0\n0 1 0\n",
     "more than the"},
    {"ply",
     "ply\nformat binary_little_endian 1.0\nelement vertex 1\nproperty float x\nproperty float y\nproperty "
     "float z\n"
     "element face 1\nproperty list uchar int vertex_indices\nend_header\n\0\0\x80\x7f\0\0\0\0\0\0\0\0\3"sv,
     "vertex 0: a coordinate is not finite"},
    {"ply",
     "ply\nformat binary_little_endian 1.0\nelement vertex 1\nproperty float x\nproperty float y\nproperty "
     "float z\n"
     "element face 1\nproperty list uchar int vertex_indices\nend_header\n\0\0\0\0\0\0\0\0\0\0\0\0\3\0\0\0\0"sv,
     "ends inside face 0"},
    {"ply",
     "ply\nformat binary_big_endian 1.0\nelement vertex 1\nproperty float x\nproperty float y\nproperty "
     "float z\n"
     "element face 1\nproperty list int int vertex_indices\nend_header\n\0\0\0\0\0\0\0\0\0\0\0\0\x7f\xff\xff\xff"sv,
     "a list of 2147483647 values"},
    {"off", "", "a.off: the file is empty"},
    {"off", "OFF\n", "where the counts of vertices, faces and edges should be"},
    {"off", "OFF BINARY\n", "binary OFF is not accepted"},
    {"off", "4OFF\n1 1 1\n", "only points of three dimensions"},
    {"off", "OFF\n-1 1 0\n", "the number of vertices is -1"},
    {"off", "OFF\n3000000000 1 0\n", "at most"},
    {"ply", "ply\nformat binary_little_endian 1.0\nelement vertex 2000000000\n",
     "a.ply:3: the number of elements is 2000000000; accepted are 0 to 1073741824"},
    {"off", "OFF\n3 1 0\n0 0 0\n1 0 0\n", "ends after line 4, where vertex 2 of 3"},
    {"off", "OFF\n3 1 0\n0 0 0\n1 0 0\n0 1 0\n3 0 1\n", "a.off:6: the index of a corner is missing"},
    {"off", "OFF\n3 1 0\n0 0 0\n1 0 0\n0 1 0\n3 0 1 3\n", "a.off:6: vertex 3 does not exist"},
    {"off", "OFF\n3 1 0\n0 0 0\n1 0 0\n0 1 0\n2 0 1\n", "a face of 2 corners"},
    {"off", "OFF\n3 1 0\n0 0 0\n1 0 0\n0 1 0\n3 0 1 2\n3 0 1 2\n", "a line after the last of the 1 faces"},
    {"off", "OFF\n3 0 0\n0 0 0\n1 0 0\n0 1 0\n", "there is no triangle"},
    {"off", "OFF\n3 1 0\n0 0 0\n1 0 0\n0 1 0\n3 0 1 1\n", "degenerate"},
    {"off", "OFF\n3 1 0\n0 0 0\n1 0 0\n2 0 0\n3 0 1 2\n", "degenerate"},
    {"off", "OFF\n3 1 0\n0 0 0\n1e70 0 0\n0 1 0\n3 0 1 2\n", "lies beyond"},
    {"obj", "", "a.obj: the file is empty"},
    {"obj", "# nothing\n", "a.obj: there is no triangle"},
    {"obj", "v 0 0 0\nv 1 0 0\nv 0 1 0\n", "there is no triangle"},
    {"obj", "v 0 0\n", "a.obj:1: the coordinate z is missing"},
    {"obj", "v 0 0 z\n", "a.obj:1: the coordinate z is 'z'"},
    {"obj", "v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2\n", "a.obj:4: a face of 2 corners"},
    {"obj", "v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 4\n", "a.obj:4: vertex 4 does not exist; there are 3 so far"},
    {"obj", "v 0 0 0\nv 1 0 0\nv 0 1 0\nf 0 1 2\n", "vertex 0 does not exist"},
    {"obj", "v 0 0 0\nv 1 0 0\nv 0 1 0\nf -1 -2 -4\n", "vertex -4 does not exist"},
    {"obj", "v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 x\n", "the vertex 'x' is not an integer"},
    {"obj", "v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 /3\n", "is not an integer"},
    {"obj", "v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 99999999999999999999\n", "does not exist"},
    {"obj", "v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n", "the surface is open: 3 edges"},
    {"obj", "v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\nf 1 3 2\n", "have the same vertices"},
};

#define MSH2 "$MeshFormat\n2.2 0 8\n$EndMeshFormat\n"
#define MSH4 "$MeshFormat\n4.1 0 8\n$EndMeshFormat\n"
#define NODES "$Nodes\n4\n1 0 0 0\n2 1 0 0\n3 0 1 0\n4 0 0 1\n$EndNodes\n"
#define VTK "# vtk DataFile Version 3.0\nx\nASCII\nDATASET UNSTRUCTURED_GRID\n"
#define POINTS VTK "POINTS 4 float\n0 0 0 1 0 0 0 1 0 0 0 1\n"
#define VTU(attributes) "<VTKFile type='UnstructuredGrid' " attributes "><UnstructuredGrid>"
#define PIECE \
  "<Piece NumberOfPoints='1' NumberOfCells='1'><Points>\n<DataArray type='Float32' NumberOfComponents='3' "
#define VEG "*VERTICES\n4 3 0 0\n1 0 0 0\n2 1 0 0\n3 0 1 0\n4 0 0 1\n*ELEMENTS\nTET\n"

const BadFile kBadTetFiles[] = {
    {"msh", "", "a.msh: the file is empty"},
    {"msh", "solid\n", "a.msh:1: a Gmsh file starts with '$MeshFormat'"},
    {"msh", "$MeshFormat\n3 0 8\n$EndMeshFormat\n",
     "a.msh:2: version 3 of the format; 1, 2, 2.1, 2.2 and 4.1"},
    {"msh", "$MeshFormat\n2.2 7 8\n", "a.msh:2: the file's type is neither"},
    {"msh", "$MeshFormat\n2.2 1 8\n\2\0\0\0"sv,
     "a.msh, byte 20: the number after $MeshFormat must be 1, little- or big-endian; found 0x00000002"},
    {"msh", "$MeshFormat\n2.2 1 8\n\1\0"sv, "a.msh: ends where the number one"},
    {"msh",
     "$MeshFormat\n2.2 1 8\n\1\0\0\0\n$EndMeshFormat\n$Nodes\n1\n\1\0\0\0\0\0\0\0\0\0\xf8\x7f"
     "12345678abcdefgh\n$EndNodes\n"sv,
     "a coordinate is not finite"},
    {"msh", MSH2 "$Nodes\n4000000000\n", "a.msh:5: the number of nodes is 4000000000; at most"},
    {"msh", MSH2 "$Nodes\n-1\n", "a.msh:5: the number of nodes is -1"},
    {"msh", MSH2 "$Nodes\n1\n1 0 0 nan\n$EndNodes\n",
     "a.msh:6: the coordinate z is 'nan', not a finite number"},
    {"msh", MSH2 "$Nodes\n1\n1 0 0 x\n$EndNodes\n", "a.msh:6: the coordinate z is 'x', not a number"},
    {"msh", MSH2 "$Nodes\n1\n99999999999 0 0 0\n$EndNodes\n",
     "a.msh:6: the number of a node is 99999999999, out of"},
    {"msh", MSH2 "$Nodes\n2\n1 0 0 0\n1 1 0 0\n$EndNodes\n", "there are two nodes with the number 1"},
    {"msh", MSH2 "$Nodes\n1\n1 0 0 0\n2 0 0 0\n$EndNodes\n", "a.msh:7: '$EndNodes' expected"},
    {"msh", MSH2 NODES, "a.msh: there is no tetrahedron in it"},
    {"msh", MSH2 NODES "$Elements\n1\n1 2 0 1 2 3\n$EndElements\n",
     "no tetrahedron in it (1 points, lines or faces)"},
    {"msh", MSH2 NODES "$Elements\n1\n1 4 0 1 2 3 9\n$EndElements\n",
     "a.msh:13: the node 9 does not exist; there are 4, the first is 1"},
    {"msh", MSH2 NODES "$Elements\n1\n1 4 0 1 2 3\n$EndElements\n",
     "a.msh:14: a node of an element is '$EndElements'"},
    {"msh", MSH2 NODES "$Elements\n2\n1 4 0 1 2 3 4\n", "a.msh: ends where the number of an element"},
    {"msh", MSH2 NODES "$Elements\n1\n1 5 0 1 2 3 4\n", "an element of type 5 (hexahedron"},
    {"msh", MSH2 NODES "$Elements\n1\n1 999 0 1 2 3 4\n", "the element type 999 is not known"},
    {"msh", MSH2 NODES "$Elements\n1\n1 4 -1 1 2 3 4\n", "an element of -1 tags"},
    {"msh", MSH2 NODES "$Elements\n1\n1 4 2 4294967296 1 1 2 3 4\n",
     "a tag of an element is 4294967296, out of range"},
    {"msh", MSH2 "$Periodic\n1\n", "the section '$Periodic' has no end"},
    {"msh", MSH2 "hello\n", "a section such as '$Nodes' expected"},
    {"msh", MSH4 "$Nodes\n1 99999999999 1 1\n", "a.msh:5: the number of nodes is 99999999999; at most"},
    {"msh", MSH4 "$Nodes\n1 2 1 1\n3 1 0 1\n1\n0 0 0\n$EndNodes\n",
     "there are 1 nodes in the blocks; the section declares 2"},
    {"msh", MSH4 "$Nodes\n1 1 1 1\n5 1 0 1\n1\n0 0 0\n$EndNodes\n", "an entity of dimension 5"},
    {"vtk", "hello\n", "a.vtk:1: the first line must be like '# vtk DataFile"},
    {"vtk", "# vtk DataFile Version 3.0\nx\nEBCDIC\n",
     "a.vtk:3: 'ASCII' or 'BINARY' expected, found 'ebcdic'"},
    {"vtk", "# vtk DataFile Version 3.0\nx\nASCII\nDATASET POLYDATA\n",
     "a data set of the kind 'POLYDATA'; UNSTRUCTURED_GRID is accepted. A surface to fill can be .stl, .ply"},
    {"vtk", VTK, "a.vtk: there is no tetrahedron in it"},
    {"vtk", VTK "POINTS 3000000000 float\n", "a.vtk:5: the number of points is 3000000000; at most"},
    {"vtk", VTK "POINTS 1 half\n", "the type of numbers 'half' is not known"},
    {"vtk", VTK "POINTS 1 float\n0 0 inf\n", "a.vtk:6: the coordinate z is 'inf'"},
    {"vtk", POINTS "CELLS 1 5\n4 0 1 2 3\n", "a.vtk: there are cells and no 'CELL_TYPES'"},
    {"vtk", POINTS "CELLS 1 5\n4 0 1 2 4\nCELL_TYPES 1\n10\n", "the node 4 does not exist"},
    {"vtk", POINTS "CELLS 1 5\n5 0 1 2 3\n", "cell 0 has 5 points: more than the size 5"},
    {"vtk", POINTS "CELLS 1 5\n-1 0 1 2 3\n", "cell 0 has -1 points"},
    {"vtk", POINTS "CELLS 1 4\n3 0 1 2\nCELL_TYPES 1\n10\n", "cell 0 has 3 points; its type has 4"},
    {"vtk", POINTS "CELLS 1 5\n4 0 1 2 3\nCELL_TYPES 2\n10\n10\n", "types of 2 cells; there are 1"},
    {"vtk", POINTS "CELLS 1 5\n4 0 1 2 3\nCELL_TYPES 1\n12\n",
     "cell 0 is of type 12; of cells of three dimensions"},
    {"vtk", POINTS "CELLS 2 4\nOFFSETS vtktypeint64\n0 9\n", "the offset 9 of cell 1 is out of order"},
    {"vtk",
     POINTS
     "CELLS 1 5\n4 0 1 2 3\nCELL_TYPES 1\n10\nCELL_DATA 1\nSCALARS region int\nLOOKUP_TABLE default\nx\n",
     "a.vtk:14: a value of the array 'region' is 'x'"},
    {"vtk", POINTS "nonsense 3\n", "data expected, found 'nonsense'"},
    {"vtk",
     "# vtk DataFile Version 3.0\nx\nBINARY\nDATASET UNSTRUCTURED_GRID\nPOINTS 1 float\n\x7f\xc0\0\0abcdefgh"sv,
     "a coordinate of point 0 is not finite"},
    {"vtk", "# vtk DataFile Version 3.0\nx\nBINARY\nDATASET UNSTRUCTURED_GRID\nPOINTS 1 float\nabc",
     "ends where the coord"},
    {"vtu", "hello", "a.vtu: a VTK XML file starts with '<VTKFile'"},
    {"vtu", "<html></html>", "a.vtu:1: a VTK XML file starts with '<VTKFile', found '<html'"},
    {"vtu", "\x9e\x01<q\xff\x90z \xd8\x12|L\x01 >", "a.vtu:1: is damaged, or not XML: a tag holds '??|L?'"},
    {"vtu", "<VTKFile type='PolyData'>", "a VTK file of the type 'PolyData'"},
    {"vtu", VTU("compressor='vtkLZ4DataCompressor'"), "the compressor 'vtkLZ4DataCompressor'"},
    {"vtu", VTU("byte_order='Middle'"), "the byte order 'Middle'"},
    {"vtu", VTU(""), "a.vtu: ends inside <UnstructuredGrid>"},
    {"vtu", VTU("") "</Piece>", "the tag '</Piece>' closes nothing"},
    {"vtu", VTU("") "<Piece NumberOfPoints='-4'", "a tag has no end"},
    {"vtu", VTU("") "<Piece NumberOfPoints='-4' NumberOfCells='1'>", "NumberOfPoints is '-4', not a count"},
    {"vtu", VTU("") "<Piece NumberOfPoints=4>",
     "the value of the attribute 'NumberOfPoints' is not in quotes"},
    {"vtu", VTU("") PIECE "format='ascii'>0 0 nan</DataArray>", "a.vtu:2: a value of an array is 'nan'"},
    {"vtu", VTU("") PIECE "format='ascii'>0 0</DataArray></Points></Piece></UnstructuredGrid></VTKFile>",
     "a.vtu: the points are 2 numbers; the piece declares 3"},
    {"vtu", VTU("") PIECE "format='binary'>DAAAA!==</DataArray>", "a.vtu:2: the array '' is not base64: '!'"},
    {"vtu", VTU("") PIECE "format='binary'>////////</DataArray>",
     "ends too early: 4294967295 bytes should follow"},
    {"vtu",
     VTU("compressor='vtkZLibDataCompressor'") PIECE
     "format='binary'>AQAAAP///38AAAAAAQAAAA==eA==</DataArray>",
     "a block of 1 bytes cannot hold 2147483647"},
    {"vtu",
     VTU("compressor='vtkZLibDataCompressor'") PIECE
     "format='binary'>AQAAAAwAAAAAAAAAAQAAAA==eA==</DataArray>",
     "a compressed block is damaged"},
    {"vtu", VTU("") PIECE "format='appended' offset='0'/>", "is in appended data, and there are none"},
    {"vtu", VTU("") PIECE "format='appended' offset='9'/><AppendedData encoding='raw'>_12",
     "has an offset behind the end"},
    {"mesh", "Vertices\n", "a.mesh:1: a Medit file in ASCII starts with 'MeshVersionFormatted'"},
    {"mesh", "MeshVersionFormatted 2\nDimension 2\n", "a.mesh:2: the dimension is not 3"},
    {"mesh", "MeshVersionFormatted 2\nDimension 3\nVertices\n1000000000\n",
     "a.mesh:4: the number of vertices is 1000000000"},
    {"mesh", "MeshVersionFormatted 2\nVertices 1\n0 0 0 0\nTetrahedra 1\n1 1 1 2 0\n",
     "a.mesh:5: the node 2 does not exist"},
    {"mesh", "MeshVersionFormatted 2\nVertices 1\n0 0 0 0 0\nEnd\n",
     "a keyword such as 'Vertices' expected, found '0'"},
    {"mesh", "MeshVersionFormatted 2\nHexahedra 1\n", "elements of the kind 'Hexahedra'"},
    {"mesh", "MeshVersionFormatted 2\nTetrahedra 1\n", "ends where a vertex of tetrahedron 1"},
    {"mesh", "MeshVersionFormatted 2\nTetrahedra 1\n1 1 1 2 0\nVertices 1\n0 0 0 0\n",
     "a.mesh:3: the node 2 does not exist"},
    {"mesh", "MeshVersionFormatted 2\nTetrahedra 2\n1 1 1 1 0\nVertices 1\n0 0 0 0\n",
     "a.mesh:4: a vertex of"},
    {"veg", "4 3 0 0\n", "a.veg:1: '*VERTICES', '*ELEMENTS'"},
    {"veg", "*INCLUDE b.veg\n", "'*INCLUDE' is not accepted"},
    {"veg", VEG "1 4 0\n1 1 2 3 5\n", "a.veg:10: the node 5 does not exist"},
    {"veg", VEG "1 8 0\n", "a tetrahedron has 4 vertices"},
    {"veg", "*ELEMENTS\nCUBIC\n", "a.veg:2: elements of the kind 'CUBIC'"},
    {"veg", VEG "2 4 0\n1 1 2 3 4\n3 1 2 3 4\n", "the element's number is 3, expected 2"},
    {"veg", VEG "1 4 0\n1 1 2 3 4\n*SET s\n2,\n", "the element 2 does not exist; there are 1"},
    {"veg", VEG "1 4 0\n1 1 2 3 4\n*REGION\nallElements, BODY\n", "there is no such material"},
    {"veg", VEG "1 4 0\n1 1 2 3 4\n*REGION\nbody, BODY\n", "a.veg:12: there is no set 'body'"},
};

// Loads, and expects one line that starts with a path and contains `part`.
void expect_error(const std::filesystem::path& path, std::string_view part) {
  LoadOptions options;
  options.fill.use_cache = false;
  const std::string error = error_of([&] { load_mesh(path, options); });
  EXPECT_NE(error.find(part), std::string::npos) << "got:      " << error << "\nexpected: " << part;
  EXPECT_NE(error.find("/a."), std::string::npos) << "no file name in: " << error;
  EXPECT_EQ(error.find('\n'), std::string::npos) << "more than a line: " << error;
  for (const char c : error) EXPECT_TRUE(c >= ' ' && c <= '~') << "not printable: " << error;
}

TEST(Malformed, NodeFiles) {
  for (const BadFile& bad : kBadNodes) {
    const TestDirectory directory;
    directory.write("a.ele", "1 4 0\n0 0 1 2 3\n");
    directory.write("a.node", bad.bytes);
    expect_error(directory / "a.node", bad.error);
  }
}

TEST(Malformed, EleFiles) {
  for (const BadFile& bad : kBadElements) {
    const TestDirectory directory;
    directory.write("a.node", kGoodNodes);
    directory.write("a.ele", bad.bytes);
    expect_error(directory / "a.ele", bad.error);
  }
}

TEST(Malformed, SurfaceFiles) {
  for (const BadFile& bad : kBadSurfaces) {
    const TestDirectory directory;
    expect_error(directory.write(std::string("a.") + bad.ending, bad.bytes), bad.error);
  }
}

TEST(Malformed, TetFiles) {
  for (const BadFile& bad : kBadTetFiles) {
    const TestDirectory directory;
    expect_error(directory.write(std::string("a.") + bad.ending, bad.bytes), bad.error);
  }
}

TEST(Malformed, BinaryStl) {
  const auto stl = [](std::uint32_t declared, std::size_t triangles, float value) {
    std::string bytes(84 + 50 * triangles, '\0');
    std::memcpy(bytes.data() + 80, &declared, 4);
    for (std::size_t i = 0; i < triangles; ++i) {
      const float corners[9] = {0, 0, 0, 1, 0, 0, 0, 1, value};
      std::memcpy(bytes.data() + 84 + 50 * i + 12, corners, sizeof corners);
    }
    return bytes;
  };
  const TestDirectory directory;
  expect_error(directory.write("a.stl", stl(4'000'000'000u, 1, 0)),
               "4000000000 triangles take 200000000084 bytes, the file has 134");
  expect_error(directory.write("a.stl", stl(2, 1, 0)), "2 triangles take 184 bytes, the file has 134");
  expect_error(directory.write("a.stl", stl(1, 1, std::numeric_limits<float>::infinity())),
               "triangle 0, corner 2: a coordinate is not finite");
  expect_error(directory.write("a.stl", stl(0, 0, 0)), "there is no triangle");
  expect_error(directory.write("a.stl", stl(1, 1, 0)), "the surface is open");
  expect_error(directory.write("a.stl", stl(2, 2, 0)), "have the same vertices");
  expect_error(directory.write("a.stl", stl(1, 1, 0).substr(0, 83)), "shorter than its header");
}

TEST(Malformed, NotAFile) {
  const TestDirectory directory;
  expect_error(directory / "a.node", "no such file");
  expect_error(directory / "a.stl", "no such file");
  std::filesystem::create_directory(directory / "a.stl");
  expect_error(directory / "a.stl", "not a regular file");
  directory.write("a.node", kGoodNodes);
  expect_error(directory / "a.node",
               "a.ele: no such file; " + (directory / "a.node").string() +
                   " has only the points: put the other file of TetGen's pair beside it");
  std::filesystem::rename(directory / "a.node", directory / "a.ele");
  expect_error(directory / "a.ele", "a.node: no such file; " + (directory / "a.ele").string() +
                                        " has only the tetrahedra: put the other");
  std::filesystem::create_symlink("/dev/zero", directory / "a.off");
  expect_error(directory / "a.off", "not a regular file");
}

TEST(Malformed, FaceOfThreeTetrahedra) {
  const TestDirectory directory;
  directory.write("a.node", "6 3\n1 0 0 0\n2 1 0 0\n3 0 1 0\n4 0 0 1\n5 0 0 -1\n6 1 1 1\n");
  directory.write("a.ele", "3 4\n1 1 2 3 4\n2 1 3 2 5\n3 1 2 3 6\n");
  expect_error(directory / "a",
               "3 tetrahedra (1, 2, 3) share the face with vertex 1 at (0, 0, 0), vertex 2 at (1, 0, 0) and "
               "vertex 3 at (0, 1, 0)");
}

// Every prefix of a good file, and every file with one byte changed, loads or gets a MeshError.
TEST(Malformed, CutShortAndAlteredFiles) {
  const TestDirectory directory;
  LoadOptions options;
  options.fill.use_cache = false;
  options.fill.tetgen_switches = "pY";
  options.fill.target_tets = 0;
  std::mt19937 random(1);
  const auto load = [&](const std::filesystem::path& path) {
    try {
      std::vector<std::string> warnings;
      const Surface surface = read_surface(path, warnings);
      for (const auto& t : surface.triangles) {
        for (const auto v : t) ASSERT_LT(v, surface.positions.size());
      }
    } catch (const MeshError&) {
    }
  };
  for (const char* name : {"a.stl", "a.ply", "a.off", "a.obj"}) {
    SCOPED_TRACE(name);
    write_surface(directory / name, cube({0.1, 0.2, 0.3}, 0.7));
    std::string good(std::filesystem::file_size(directory / name), '\0');
    FILE* file = std::fopen((directory / name).c_str(), "rb");
    ASSERT_EQ(std::fread(good.data(), 1, good.size(), file), good.size());
    std::fclose(file);
    for (std::size_t length = 0; length < good.size(); length += 1 + length / 20) {
      load(directory.write(name, good.substr(0, length)));
    }
    for (int i = 0; i < 150; ++i) {
      std::string bad = good;
      bad[random() % bad.size()] = static_cast<char>(random());
      load(directory.write(name, bad));
    }
  }
}

}  // namespace
}  // namespace incise::mesh_io
