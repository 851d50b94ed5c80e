from xml.etree import ElementTree

from setuptools import find_packages, setup

NAME = 'humanopts_ros'

setup(
    name=NAME,
    version=ElementTree.parse('package.xml').findtext('version'),
    install_requires=[
        'numpy>=1.26.4',
        'psutil>=5.9.8',
        'pydantic>=2.7',
        'pyyaml>=6.0.1',
    ],
    python_requires='>=3.11',
    packages=find_packages(exclude=['test']),
    package_data={NAME: ['py.typed', '*.xml', 'foreign_variables.txt']},
    data_files=[
        ('share/ament_index/resource_index/packages', [f'resource/{NAME}']),
        (f'share/{NAME}', ['package.xml']),
    ],
)
