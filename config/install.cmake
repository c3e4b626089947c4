# What `cmake --install` puts where, and the Debian packages that CPack makes of it (./dev package):
#   incise         the command line, and incise-tetgen
#   incised        the server: service, configuration, device profiles, the page for browsers
#   libincise-dev  headers and static libraries of incise::core, incise::protocol and incise::client
#   python3-incise the Python packages incise and incise_client
include(GNUInstallDirs)
include(CMakePackageConfigHelpers)
set(INCISE_SHARE ${CMAKE_INSTALL_DATADIR}/incise)
set(INCISE_ETC ${CMAKE_INSTALL_SYSCONFDIR}/incise)

# --- Programs
install(TARGETS incise incise-tetgen RUNTIME COMPONENT incise)
install(TARGETS incised incise-relay RUNTIME COMPONENT incised)
install(FILES ${CMAKE_BINARY_DIR}/manual/incise.1 DESTINATION ${CMAKE_INSTALL_MANDIR}/man1 COMPONENT incise)
install(FILES ${CMAKE_BINARY_DIR}/manual/incised.8 ${CMAKE_BINARY_DIR}/manual/incise-relay.8 DESTINATION ${CMAKE_INSTALL_MANDIR}/man8 COMPONENT incised)
foreach(program incise incised)
  install(FILES ${CMAKE_BINARY_DIR}/manual/${program}.bash RENAME ${program}
    DESTINATION ${CMAKE_INSTALL_DATADIR}/bash-completion/completions COMPONENT ${program})
  install(FILES LICENSE RENAME copyright DESTINATION ${CMAKE_INSTALL_DATADIR}/doc/${program} COMPONENT ${program})
endforeach()
install(FILES ${CMAKE_BINARY_DIR}/manual/incise-relay.bash RENAME incise-relay
  DESTINATION ${CMAKE_INSTALL_DATADIR}/bash-completion/completions COMPONENT incised)
# In their folders, so that the links between them hold.
foreach(page README.md CHANGELOG.md CONTRIBUTING.md client/CLIENTS.md client/ROS2.md client/SOFA.md client/unity/README.md client/viewer/PAGE.md config/devices/DEVICES.md protocol/PROTOCOL.md
    server/ARCHITECTURE.md server/OPERATING.md server/cluster/NATS.md server/core/CUTTING.md server/haptics/FORCES.md server/input/PEERS.md
    server/mesh_io/FORMATS.md)
  cmake_path(GET page PARENT_PATH folder)
  install(FILES ${page} DESTINATION ${CMAKE_INSTALL_DATADIR}/doc/incised/${folder} COMPONENT incised)
endforeach()

# --- The server's configuration, devices, page, service
if(INCISE_VIEWER)
  install(DIRECTORY ${CMAKE_BINARY_DIR}/viewer/ DESTINATION ${INCISE_SHARE}/viewer COMPONENT incised)
endif()
install(FILES config/tissues.json DESTINATION ${INCISE_SHARE} COMPONENT incised)
install(DIRECTORY config/devices DESTINATION ${INCISE_SHARE} COMPONENT incised FILES_MATCHING PATTERN "*.json")
file(READ config/incised.json incised_json)
if(INCISE_VIEWER)
  string(REPLACE "\"viewer_directory\": \"\"" "\"viewer_directory\": \"${CMAKE_INSTALL_FULL_DATADIR}/incise/viewer\"" incised_json
    "${incised_json}")
endif()
# The service records. Its state directory is systemd's, whatever the prefix; and it leaves room to what else lives there.
string(REGEX REPLACE "(\"capture\": {[^}]*\"path\": )\"\"" "\\1\"/var/lib/incise/session.capture\"" incised_json "${incised_json}")
string(REGEX REPLACE "(\"keep_free_percent\": )[0-9.]+" "\\110" incised_json "${incised_json}")
file(WRITE ${CMAKE_BINARY_DIR}/install/incised.json "${incised_json}")
install(FILES ${CMAKE_BINARY_DIR}/install/incised.json DESTINATION ${INCISE_ETC} COMPONENT incised)
foreach(unit incised incised@ incise-relay@)
  configure_file(config/${unit}.service.in install/${unit}.service @ONLY)
  install(FILES ${CMAKE_BINARY_DIR}/install/${unit}.service DESTINATION lib/systemd/system COMPONENT incised)
endforeach()
install(FILES config/sysusers.conf RENAME incised.conf DESTINATION lib/sysusers.d COMPONENT incised)
# The service is nobody at the console: it reads the devices by its group.
file(READ config/70-incise-devices.rules rules)
string(REPLACE "TAG+=\"uaccess\"" "TAG+=\"uaccess\", GROUP=\"incise\", MODE=\"0660\"" rules "${rules}")
file(WRITE ${CMAKE_BINARY_DIR}/install/70-incise-devices.rules "${rules}")
install(FILES ${CMAKE_BINARY_DIR}/install/70-incise-devices.rules DESTINATION lib/udev/rules.d COMPONENT incised)

# --- Libraries
foreach(part core protocol net client)
  set_target_properties(incise_${part} PROPERTIES EXPORT_NAME ${part})
  target_compile_features(incise_${part} PUBLIC cxx_std_20)
  target_include_directories(incise_${part} INTERFACE $<INSTALL_INTERFACE:${CMAKE_INSTALL_INCLUDEDIR}/incise>)
  # The linker may keep a user's copy of our inline arithmetic: it must round as ours does.
  target_compile_options(incise_${part} INTERFACE $<INSTALL_INTERFACE:-ffp-contract=off>)
endforeach()
install(TARGETS incise_core incise_protocol incise_net incise_client EXPORT incise ARCHIVE COMPONENT dev)
install(EXPORT incise NAMESPACE incise:: DESTINATION ${CMAKE_INSTALL_LIBDIR}/cmake/incise FILE inciseTargets.cmake COMPONENT dev)
file(WRITE ${CMAKE_BINARY_DIR}/install/inciseConfig.cmake
  "include(CMakeFindDependencyMacro)\nfind_dependency(Threads)\nfind_dependency(OpenSSL)\n"
  "include(\${CMAKE_CURRENT_LIST_DIR}/inciseTargets.cmake)\n")
write_basic_package_version_file(${CMAKE_BINARY_DIR}/install/inciseConfigVersion.cmake COMPATIBILITY SameMinorVersion)
install(FILES ${CMAKE_BINARY_DIR}/install/inciseConfig.cmake ${CMAKE_BINARY_DIR}/install/inciseConfigVersion.cmake
  DESTINATION ${CMAKE_INSTALL_LIBDIR}/cmake/incise COMPONENT dev)
file(GLOB headers RELATIVE ${CMAKE_SOURCE_DIR} CONFIGURE_DEPENDS client/*.hpp protocol/*.hpp server/base/*.hpp)
file(GLOB_RECURSE core_headers RELATIVE ${CMAKE_SOURCE_DIR} CONFIGURE_DEPENDS server/core/*.hpp)
list(APPEND headers ${core_headers})
list(REMOVE_ITEM headers client/client_impl.hpp client/link.hpp protocol/field_reader.hpp) # Asio and the generated schema, for our sources alone
foreach(header ${headers})
  cmake_path(GET header PARENT_PATH folder)
  install(FILES ${header} DESTINATION ${CMAKE_INSTALL_INCLUDEDIR}/incise/${folder} COMPONENT dev)
endforeach()
install(FILES protocol/incise.fbs DESTINATION ${INCISE_SHARE} COMPONENT dev)
install(FILES LICENSE RENAME copyright DESTINATION ${CMAKE_INSTALL_DATADIR}/doc/libincise-dev COMPONENT dev)

# --- Python. Debian's folder for packages does not depend on the version, so the module says which Python it is for.
if(TARGET incise_module)
  set(INCISE_PYTHON_PACKAGES lib/python3/dist-packages)
  install(TARGETS incise_module LIBRARY DESTINATION ${INCISE_PYTHON_PACKAGES}/incise COMPONENT python)
  install(DIRECTORY client/python/incise client/python/incise_client DESTINATION ${INCISE_PYTHON_PACKAGES} COMPONENT python
    FILES_MATCHING PATTERN "*.py" PATTERN "*.pyi" PATTERN "py.typed" PATTERN "__pycache__" EXCLUDE)
  install(DIRECTORY ${CMAKE_BINARY_DIR}/generated/python/incise/wire DESTINATION ${INCISE_PYTHON_PACKAGES}/incise COMPONENT python
    FILES_MATCHING PATTERN "*.py")
  install(DIRECTORY client/python/examples DESTINATION ${CMAKE_INSTALL_DATADIR}/doc/python3-incise COMPONENT python
    FILES_MATCHING PATTERN "*.py")
  install(FILES LICENSE RENAME copyright DESTINATION ${CMAKE_INSTALL_DATADIR}/doc/python3-incise COMPONENT python)
endif()

# --- Debian packages
set(CPACK_GENERATOR DEB)
set(CPACK_PACKAGE_NAME incise)
set(CPACK_PACKAGE_CONTACT "Incise maintainers <maintainers@incise.invalid>")
set(CPACK_PACKAGING_INSTALL_PREFIX /usr)
set(CPACK_STRIP_FILES ON)
set(CPACK_COMPONENTS_ALL incise incised dev python)
set(CPACK_DEB_COMPONENT_INSTALL ON)
set(CPACK_DEBIAN_FILE_NAME DEB-DEFAULT)
set(CPACK_DEBIAN_PACKAGE_SHLIBDEPS ON)
set(CPACK_DEBIAN_PACKAGE_SECTION science)
set(CPACK_DEBIAN_INCISE_PACKAGE_NAME incise)
set(CPACK_DEBIAN_INCISE_DESCRIPTION "Cut tetrahedral meshes with a moving blade
The command line of Incise: cuts, replays, converts and shows meshes, motions and
captures, and talks to a running cut server.")
set(CPACK_DEBIAN_INCISED_PACKAGE_NAME incised)
set(CPACK_DEBIAN_INCISED_PACKAGE_DEPENDS "incise (= ${PROJECT_VERSION}), systemd | systemd-standalone-sysusers")
set(CPACK_DEBIAN_INCISED_DESCRIPTION "Networked haptic cut server
Holds a tetrahedral mesh of soft tissue, takes blade poses at haptic rates, cuts the
mesh inside a fixed share of every millisecond, and streams what changed.")
set(CPACK_DEBIAN_INCISED_PACKAGE_CONTROL_EXTRA
  "${CMAKE_CURRENT_LIST_DIR}/debian/postinst;${CMAKE_CURRENT_LIST_DIR}/debian/prerm;${CMAKE_CURRENT_LIST_DIR}/debian/postrm;${CMAKE_CURRENT_LIST_DIR}/debian/conffiles")
set(CPACK_DEBIAN_INCISED_PACKAGE_CONTROL_STRICT_PERMISSION ON)
set(CPACK_DEBIAN_DEV_PACKAGE_NAME libincise-dev)
set(CPACK_DEBIAN_DEV_PACKAGE_SECTION libdevel)
set(CPACK_DEBIAN_DEV_PACKAGE_SHLIBDEPS OFF)
set(CPACK_DEBIAN_DEV_PACKAGE_DEPENDS "libssl-dev")
set(CPACK_DEBIAN_DEV_DESCRIPTION "Libraries for clients of the Incise cut server
Headers and static libraries: the cut core, the protocol and the client.")
set(CPACK_DEBIAN_PYTHON_PACKAGE_NAME python3-incise)
set(CPACK_DEBIAN_PYTHON_PACKAGE_SECTION python)
set(CPACK_DEBIAN_PYTHON_PACKAGE_DEPENDS "python3 (>= 3.11), python3 (<< 3.12), python3-numpy, python3-flatbuffers")
set(CPACK_DEBIAN_PYTHON_PACKAGE_RECOMMENDS "incise (= ${PROJECT_VERSION}), python3-h5py") # incise-tetgen: phantoms, surfaces; data sets
set(CPACK_DEBIAN_PYTHON_PACKAGE_SUGGESTS "python3-distributed")
set(CPACK_DEBIAN_PYTHON_DESCRIPTION "Cut tetrahedral meshes in Python
The cut core of Incise in process (import incise) and a client of the cut server
(import incise_client).")
include(CPack)
